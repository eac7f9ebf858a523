// SPDX-License-Identifier: Apache-2.0
//
// Goal: old messages are destroyed where docs/messages.md says, each once, and none is missed.
// Method: a message whose destructor records what its thread was doing. Nobody subscribes, so
// every message that a reclamation scan finds may be freed at once. With the real daemon and the
// real heap hook.

#include <agnocast/agnocast.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>

#include <sys/resource.h>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdlib>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

// The library's own threads do `nothing`.
enum class Doing : std::size_t { nothing, borrow, publish, count };
thread_local Doing doing = Doing::nothing;
std::atomic<std::size_t> destroyed_by[static_cast<std::size_t>(Doing::count)];
// Called by destructors, once for each message as long as returns_left counts.
std::atomic<int> returns_left{0};
void come_back();
// The stack that a destructor uses, as in a long chain of objects that destroy each other.
std::atomic<std::size_t> stack_pages{0};
[[gnu::noinline]] std::size_t go_down(std::size_t pages) {
  volatile char page[4000];
  page[0] = 1;
  const std::size_t below = pages > 1 ? go_down(pages - 1) : 0;
  return below + static_cast<std::size_t>(page[0]);
}

struct Noted {
  std::vector<std::byte> bytes;
  Noted() = default;
  Noted(const Noted&) = default;
  Noted& operator=(const Noted&) = default;
  ~Noted() {
    if (const std::size_t pages = stack_pages.load(); pages != 0) {
      EXPECT_EQ(go_down(pages), pages);
    }
    ++destroyed_by[static_cast<std::size_t>(doing)];
    if (returns_left.load() > 0 && returns_left.fetch_sub(1) > 0) come_back();
  }
};

std::size_t destroyed(Doing what) { return destroyed_by[static_cast<std::size_t>(what)].load(); }
std::size_t destroyed() {
  return destroyed(Doing::nothing) + destroyed(Doing::borrow) + destroyed(Doing::publish);
}

constexpr std::size_t small = 100, large = 100 * 1024;

}  // namespace

template <>
struct MessageTraits<Noted> {
  static constexpr const char* name = "tests/Noted";
  static void for_each_pointer(const Noted& noted, PointerVisitor& visit) noexcept {
    visit("bytes", noted.bytes);
  }
};

namespace {

class Destruction : public test::SuiteDaemon {
 protected:
  void SetUp() override {
    for (auto& count : destroyed_by) count.store(0);
    publisher = create_publisher<Noted>(test::PlainNode(), test_name(), QoS(1));
  }
  void TearDown() override { publisher = nullptr; }

 public:
  static void borrow_and_publish(std::size_t bytes) {
    const Doing before = std::exchange(doing, Doing::borrow);
    auto loan = publisher->borrow_loaned_message();
    doing = Doing::nothing;
    loan->bytes.resize(bytes);
    doing = Doing::publish;
    EXPECT_TRUE(publisher->publish(std::move(loan)));
    doing = before;
  }

  static Publisher<Noted>::SharedPtr publisher;
};
Publisher<Noted>::SharedPtr Destruction::publisher;

void come_back() { Destruction::borrow_and_publish(small); }

TEST_F(Destruction, OfSmallMessagesWaitsForTheNextBorrow) {
  for (int i = 0; i < 200; ++i) borrow_and_publish(small);
  EXPECT_EQ(destroyed(Doing::publish), 0u);
  EXPECT_GT(destroyed(Doing::borrow), 0u);
  EXPECT_TRUE(test::eventually([] { return destroyed() == 200; })) << destroyed();
}

TEST_F(Destruction, OfLargeMessagesIsNotDeferred) {
  for (int i = 0; i < 200; ++i) borrow_and_publish(large);
  EXPECT_EQ(destroyed(Doing::borrow), 0u);
  EXPECT_GT(destroyed(Doing::publish), 0u);
  EXPECT_TRUE(test::eventually([] { return destroyed() == 200; })) << destroyed();
}

TEST_F(Destruction, WaitsForTheNextPublishWhereNobodyBorrows) {
  for (int i = 0; i < 200; ++i) {
    std::unique_ptr<Noted> message;
    {
      const SharedHeapScope scope;
      message = std::make_unique<Noted>();
      message->bytes.resize(small);
    }
    doing = Doing::publish;
    const PublishResult result = publisher->publish(std::move(message));
    doing = Doing::nothing;
    ASSERT_TRUE(result);
    ASSERT_EQ(result.adopted_bytes, 0u);
  }
  EXPECT_GT(destroyed(Doing::publish), 0u);
  EXPECT_TRUE(test::eventually([] { return destroyed() == 200; })) << destroyed();
}

// No later call of the publisher destroys the last ones.
TEST_F(Destruction, OfTheLastMessagesIsDoneByTheLibrary) {
  for (int i = 0; i < 8; ++i) borrow_and_publish(small);
  EXPECT_TRUE(test::eventually([] { return destroyed() == 8; })) << destroyed();
  EXPECT_GT(destroyed(Doing::nothing), 0u);
}

TEST_F(Destruction, MayNeedAsMuchStackAsMainHas) {
  rlimit main_stack{};
  ASSERT_EQ(::getrlimit(RLIMIT_STACK, &main_stack), 0);
  const std::size_t bytes = std::min<rlim_t>(main_stack.rlim_cur, rlim_t{8} << 20) / 8 * 5;
  ASSERT_GT(bytes, std::size_t{4} << 20);
  for (int i = 0; i < 8; ++i) borrow_and_publish(small);
  stack_pages = bytes / 4096;
  EXPECT_TRUE(test::eventually([] { return destroyed() == 8; })) << destroyed();
  stack_pages = 0;
  EXPECT_GT(destroyed(Doing::nothing), 0u);
}

TEST_F(Destruction, MayBorrowAndPublishItself) {
  returns_left = 100;
  for (int i = 0; i < 200; ++i) borrow_and_publish(small);
  EXPECT_TRUE(test::eventually([] { return destroyed() == 300; })) << destroyed();
  EXPECT_LE(returns_left.load(), 0);
}

}  // namespace
}  // namespace agnocast
