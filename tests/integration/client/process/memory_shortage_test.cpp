// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process that briefly has no memory goes on: while endpoints come and go, while the
// daemon is restarted, while the process moves to another daemon. Nothing is lost, nothing arrives
// twice, nothing is left behind.
// Method: operator new of this program fails once, at the n-th allocation of a thread (the
// library's, or the user's) after such an event has begun, for each n.

#include <agnocast/agnocast.hpp>
#include <client/connection/reconnection.hpp>
#include <tests/integration/services/services.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/own_process.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <gtest/gtest.h>
#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <mutex>
#include <new>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace {

std::atomic<const char*> failing_thread{nullptr};
std::atomic<int> allocations{0}, fails_at{0};
constexpr int always = -1;

bool fails() noexcept {
  const char* const wanted = failing_thread.load(std::memory_order_acquire);
  if (wanted == nullptr) return false;
  char name[16] = "";
  ::pthread_getname_np(::pthread_self(), name, sizeof name);
  if (std::strcmp(name, wanted) != 0) return false;
  ++allocations;
  return fails_at == always || allocations == fails_at;
}

}  // namespace

// Not inlined: a compiler that sees the body of only one of a pair warns about new and free.
[[gnu::noinline]] void* operator new(std::size_t bytes) {
  void* const block = fails() ? nullptr : std::malloc(bytes);
  if (block == nullptr) throw std::bad_alloc();
  return block;
}
[[gnu::noinline]] void operator delete(void* block) noexcept { std::free(block); }
[[gnu::noinline]] void operator delete(void* block, std::size_t) noexcept { std::free(block); }

namespace agnocast {

namespace test {
struct Number {
  std::uint64_t value = 0;
};
}  // namespace test

namespace {

using test::eventually;

using test::Number;
using test::Repeat;

struct Case {
  const char* name;
  const char* thread;
  void (*event)();
};

class MemoryShortageOnce : public testing::Test {
 public:
  /// The daemon's store is lost, and the process moves to another daemon.
  static void lose() {
    daemon->kill();
    ASSERT_TRUE(eventually([] { return connection_state() != ConnectionState::connected; }));
    begin();
    ASSERT_TRUE(eventually([] { return connection_state() == ConnectionState::connected; }));
  }
  /// The daemon dies and is restarted.
  static void restart() {
    std::this_thread::sleep_for(Reconnection::lasting);  // so that its next attempt comes at once
    ASSERT_TRUE(daemon->wait_for_next(daemon->kill_worker()));
    come_and_go();
  }
  /// A new endpoint matches and goes; also if its creation fails at first.
  static void come_and_go() {
    ASSERT_TRUE(eventually([] {
      try {
        const auto subscription = node->create_subscription<Number>("/c", 10);
        const auto publisher = node->create_publisher<Number>("/c", 10);
        auto number = publisher->borrow_loaned_message();
        number->value = 7;
        if (!publisher->publish(std::move(number))) return false;
        return eventually([&] {
          const auto taken = subscription->take();
          return taken != nullptr && taken->value == 7;
        });
      } catch (const std::exception&) {
        return false;
      }
    }));
  }

 protected:
  friend class Stage;
  static void set_up() {
    directory = new std::string(test::make_directory());
    ::setenv("AGNOCAST_SOCKET", socket().c_str(), 1);
    begin();
    ::pthread_setname_np(::pthread_self(), "user");
    node = std::make_unique<Node>("node");
  }
  static void tear_down() {
    node.reset();
    daemon.reset();
    test::remove_directory(*directory);
  }
  static std::string socket() { return *directory + "/agnocastd.sock"; }
  static void begin() {
    test::DaemonOptions options;
    options.socket = socket();
    daemon = std::make_unique<test::DaemonProcess>(options);
  }
  static std::string* directory;
  static std::unique_ptr<test::DaemonProcess> daemon;
  static std::unique_ptr<Node> node;
};
/// The process has one library, so all tests here have one place for their daemons.
class Stage : public testing::Environment {
  void SetUp() override { MemoryShortageOnce::set_up(); }
  void TearDown() override { MemoryShortageOnce::tear_down(); }
};
const testing::Environment* const stage = testing::AddGlobalTestEnvironment(new Stage);

class MemoryShortage : public MemoryShortageOnce, public testing::WithParamInterface<Case> {};
std::unique_ptr<Node> MemoryShortageOnce::node;
std::string* MemoryShortageOnce::directory = nullptr;
std::unique_ptr<test::DaemonProcess> MemoryShortageOnce::daemon;

TEST_F(MemoryShortageOnce, DestroyingNeedsNoMemory) {
  auto subscription = node->create_subscription<Number>("/d", 10);
  auto publisher = node->create_publisher<Number>("/d", 10);
  ASSERT_NO_FATAL_FAILURE(lose());
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  fails_at = always;
  failing_thread = "user";
  subscription.reset();
  publisher.reset();
  failing_thread = nullptr;
  EXPECT_TRUE(eventually([&] { return test::wire_dump(socket()).endpoints.empty(); }));
}

TEST_F(MemoryShortageOnce, ABatchTakesAsManyAsItHasMemoryForAndLeavesTheRestUnread) {
  auto subscription = node->create_subscription<Number>("/f", 40);
  auto publisher = node->create_publisher<Number>("/f", 40);
  ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  std::uint64_t published = 0, expected = 1;
  std::vector<ipc_shared_ptr<const Number>> batch(40);
  const auto publish = [&](std::size_t count) {
    while (count-- > 0) {
      auto loan = publisher->borrow_loaned_message();
      loan->value = ++published;
      ASSERT_TRUE(publisher->publish(std::move(loan)));
    }
  };
  const auto take = [&](std::size_t wanted) {
    const std::size_t count = subscription->take_batch(batch.data(), wanted);
    for (std::size_t i = 0; i < count; ++i) EXPECT_EQ(batch[i]->value, expected++);
    return count;
  };
  publish(40);
  fails_at = always;
  failing_thread = "user";
  const std::size_t without = take(16);
  failing_thread = nullptr;
  EXPECT_EQ(without, 0u) << "none was held before";
  for (int i = 0; i < 2; ++i) EXPECT_EQ(take(16), 16u);
  publish(32);
  failing_thread = "user";
  const std::size_t once = take(16), more = take(40);
  failing_thread = nullptr;
  EXPECT_EQ(once, 16u) << "16 were held before";
  EXPECT_EQ(more, 16u);
  EXPECT_EQ(take(40), 8u);
  EXPECT_EQ(expected, published + 1);
  EXPECT_EQ(subscription->get_lost_count(), 0u);
}

TEST_F(MemoryShortageOnce, TheControlThreadDoesNotBusyLoop) {
  const auto publisher = node->create_publisher<Number>("/e", 10);
  allocations = 0;
  fails_at = always;
  failing_thread = "agnocast-ctl";
  // A cycle without memory is an allocation that fails; the thread looks about 100 times a second.
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(2);
  while (std::chrono::steady_clock::now() < until)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  failing_thread = nullptr;
  EXPECT_LT(allocations, 2000);
  ASSERT_TRUE(eventually([] { return connection_state() == ConnectionState::connected; }));
  ASSERT_NO_FATAL_FAILURE(come_and_go());
}

TEST_F(MemoryShortageOnce, EachResponseReachesItsCallback) {
  Node asker("asker");
  SingleThreadedExecutor executor;
  executor.add_node(asker);
  std::mutex mutex;
  std::vector<ServiceRequest<Repeat>> asked;
  BackgroundExecutor of_service;
  of_service.add_node(*node);
  const auto service = node->create_service<Repeat>("/f", [&](ServiceRequest<Repeat> request) {
    const std::lock_guard lock(mutex);
    asked.push_back(std::move(request));
  });
  const auto client = asker.create_client<Repeat>("/f");
  ASSERT_TRUE(client->wait_for_service(std::chrono::minutes(5)));
  int calls = 0;
  const auto ask = [&] {
    return client->async_send_request(client->borrow_loaned_request(),
                                      [&](const Client<Repeat>::SharedFuture&) { ++calls; });
  };
  const auto waits = ask();  // makes the library check for a server after each response
  int at = 0;
  do {
    auto sent = ask();
    ASSERT_TRUE(eventually([&] {
      const std::lock_guard lock(mutex);
      return asked.size() == static_cast<std::size_t>(at) + 2;
    }));
    ASSERT_TRUE(service->send_response(asked.back(), service->borrow_loaned_response()));
    allocations = 0;
    fails_at = ++at;
    failing_thread = "user";
    try {
      executor.spin_once(std::chrono::minutes(5));
    } catch (const std::bad_alloc&) {
    }
    failing_thread = nullptr;
    ASSERT_EQ(executor.spin_until_future_complete(sent, std::chrono::minutes(5)),
              FutureReturnCode::SUCCESS);
    ASSERT_EQ(calls, at) << "failed at " << at;
  } while (allocations >= at);
  EXPECT_GT(at, 1) << "no allocation failed";
}

// Long because the failing allocation, its streams and their sums are one story.
TEST_P(MemoryShortage, LosesNothing) {
  struct Stream {
    std::shared_ptr<Publisher<Number>> publisher;
    std::shared_ptr<PollingSubscriber<Number>> subscription;
  };
  std::vector<Stream> streams;
  for (const char* const topic : {"/a", "/b"}) {
    QoS qos(100);
    qos.reliable();
    if (topic[1] == 'a') qos.transient_local();
    streams.push_back({node->create_publisher<Number>(topic, qos),
                       node->create_subscription<Number>(topic, qos)});
  }
  std::uint64_t published = 0, taken = 0;
  const auto pass_on = [&](int count) {
    const std::uint64_t until = published + static_cast<std::uint64_t>(count);
    for (; published < until; ++published) {
      for (const Stream& stream : streams) {
        auto number = stream.publisher->borrow_loaned_message();
        number->value = published + 1;
        ASSERT_TRUE(stream.publisher->publish(std::move(number)));
      }
    }
    for (; taken < published; ++taken) {
      for (const Stream& stream : streams) {
        std::uint64_t value = 0;
        ASSERT_TRUE(eventually([&] {
          const auto number = stream.subscription->take();
          if (number) value = number->value;
          return number != nullptr;
        }));
        ASSERT_EQ(value, taken + 1) << stream.publisher->get_topic_name();
      }
    }
  };
  const auto is_matched = [](const Stream& stream) {
    return stream.publisher->get_linked_subscription_count() == 1;
  };

  // Counts the allocations when none fails.
  allocations = 0;
  fails_at = 0;
  failing_thread = GetParam().thread;
  ASSERT_NO_FATAL_FAILURE(GetParam().event());
  // the rest does not belong to the event
  if (GetParam().event == come_and_go) failing_thread = nullptr;
  ASSERT_NO_FATAL_FAILURE(pass_on(3));
  ASSERT_TRUE(eventually([&] { return std::all_of(streams.begin(), streams.end(), is_matched); }));
  failing_thread = nullptr;
  const int all = allocations;
  ASSERT_GT(all, 20) << "the test watched the wrong thread";

  int failed = 0;
  for (int at = 1; at <= all; ++at) {
    ASSERT_NO_FATAL_FAILURE(pass_on(2));
    allocations = 0;
    fails_at = at;
    failing_thread = GetParam().thread;
    ASSERT_NO_FATAL_FAILURE(GetParam().event());
    // the rest does not belong to the event
    if (GetParam().event == come_and_go) failing_thread = nullptr;
    ASSERT_NO_FATAL_FAILURE(pass_on(3)) << "failed at " << at;
    ASSERT_TRUE(eventually([&] { return std::all_of(streams.begin(), streams.end(), is_matched); }))
        << "failed at " << at;
    failing_thread = nullptr;
    failed += allocations >= at;
    ASSERT_NO_FATAL_FAILURE(pass_on(3)) << "failed at " << at;
    ASSERT_TRUE(eventually([&] { return test::wire_dump(socket()).endpoints.size() == 4; }))
        << "failed at " << at << ": there are " << test::wire_dump(socket()).endpoints.size();
  }
  std::printf("%s: %d of about %d allocations failed, one at a time\n", GetParam().name, failed,
              all);
  EXPECT_GT(failed, all / 2);
  for (const Stream& stream : streams) EXPECT_EQ(stream.subscription->take(), nullptr);
}

INSTANTIATE_TEST_SUITE_P(Events, MemoryShortage,
                         testing::Values(Case{"move", "agnocast-move", MemoryShortage::lose},
                                         Case{"move_control", "agnocast-ctl", MemoryShortage::lose},
                                         Case{"restart", "agnocast-ctl", MemoryShortage::restart},
                                         Case{"come_and_go", "user", MemoryShortage::come_and_go},
                                         Case{"come_and_go_control", "agnocast-ctl",
                                              MemoryShortage::come_and_go}),
                         [](const auto& param) { return std::string(param.param.name); });

}  // namespace
}  // namespace agnocast
