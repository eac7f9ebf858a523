// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process whose malloc is not the heap hook's can publish a message on an explicit shared
// allocator, so that publishers run under sanitizers.
// Method: the publisher in one process, a subscriber in another, the real daemon; the same test in
// plain and sanitized builds. The subscriber compares every member with its own computation.

#include <agnocast/abi/heaphook.h>
#include <agnocast/agnocast.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/own_process.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <gmock/gmock.h>

#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using test::Child;
using test::in_own_process;
using test::PlainNode;
using test::take_soon;

struct alignas(64) Cell {
  std::uint64_t value = 0;
  friend bool operator==(const Cell& a, const Cell& b) { return a.value == b.value; }
};

struct Track : SharedMessage {
  std::uint32_t id = 0;
  SharedString label;
  SharedVector<Cell> cells;
  SharedVector<SharedString> notes;
  friend bool operator==(const Track& a, const Track& b) {
    return a.id == b.id && a.label == b.label && a.cells == b.cells && a.notes == b.notes;
  }
};

/// Over-aligned and flat.
struct alignas(64) Pose : SharedMessage {
  double x = 0, y = 0;
};

struct Ordinary {
  std::vector<int> numbers;
};

}  // namespace

template <>
struct MessageTraits<Track> {
  static constexpr const char* name = "tests/Track";
  static void for_each_pointer(const Track& track, PointerVisitor& visit) noexcept {
    visit("label", track.label);
    visit("cells", track.cells);
    visit("notes", track.notes);
    for (const SharedString& note : track.notes) visit("notes[]", note);
  }
};
template <>
struct MessageTraits<Pose> {
  static constexpr const char* name = "tests/Pose";
};
template <>
struct MessageTraits<Ordinary> {
  static constexpr const char* name = "tests/Ordinary";
};

namespace {

/// Fills it in steps, so that vectors move and free memory.
void fill(Track& track, std::uint32_t id) {
  track.id = id;
  track.label = "a label that does not fit into a string object, of track ";
  track.label += std::to_string(id).c_str();
  for (std::uint32_t i = 0; i < id * 37 % 2000; ++i) {
    Cell cell;
    cell.value = std::uint64_t{id} << 32 | i;
    track.cells.push_back(cell);
  }
  for (std::uint32_t i = 0; i < id % 5; ++i)
    track.notes.emplace_back(100 * (i + 1), static_cast<char>('a' + i));
}
Track track_of(std::uint32_t id) {
  Track track;
  fill(track, id);
  return track;
}

class ExplicitAllocator : public testing::Test {
 protected:
  void SetUp() override { ::setenv("AGNOCAST_SOCKET", daemon_.socket_path().c_str(), 1); }
  test::DaemonProcess daemon_;
};

constexpr std::uint32_t message_count = 300;

TEST_F(ExplicitAllocator, MessagesOfAnyThreadCrossProcessesWithoutACopy) {
  int ready[2];
  ASSERT_EQ(::pipe(ready), 0);
  Child subscriber([&]() noexcept {
    auto subscription = create_subscription<Track>(PlainNode(), "tracks", QoS(message_count));
    if (::write(ready[1], "", 1) != 1) return 1;
    for (std::uint32_t id = 1; id <= message_count; ++id) {
      const auto track = take_soon(subscription);
      if (!track) return 2;
      if (!(*track == track_of(id))) return 3;
    }
    return 0;
  });
  char byte = 0;
  ASSERT_EQ(::read(ready[0], &byte, 1), 1) << "the subscription exists before the publisher";
  EXPECT_TRUE(in_own_process([] {
    auto publisher = create_publisher<Track>(PlainNode(), "tracks", message_count);
    for (std::uint32_t id = 1; id <= message_count; ++id) {
      PublishResult result;
      if (id % 2 == 0) {
        auto loan = publisher->borrow_loaned_message();
        fill(*loan, id);
        result = publisher->publish(std::move(loan));
      } else {
        std::unique_ptr<Track> made;
        std::thread([&] { made = std::make_unique<Track>(track_of(id)); }).join();
        result = publisher->publish(std::move(made));
      }
      ASSERT_TRUE(result) << sentence_of(result.code);
      EXPECT_EQ(result.adopted_bytes, 0u);
    }
  }));
  EXPECT_EQ(subscriber.wait(), 0) << "2: too few messages, 3: a wrong one";
}

TEST_F(ExplicitAllocator, OverAlignedMessagesAreAligned) {
  EXPECT_TRUE(in_own_process([] {
    auto subscription = create_subscription<Pose>(PlainNode(), "poses", QoS(1));
    auto publisher = create_publisher<Pose>(PlainNode(), "poses", 1);
    auto loan = publisher->borrow_loaned_message();
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(loan.get()) % 64, 0u);
    loan->x = 3;
    const PublishResult result = publisher->publish(std::move(loan));
    ASSERT_TRUE(result);
    EXPECT_EQ(result.adopted_bytes, 0u);
    EXPECT_EQ(take_soon(subscription)->x, 3);
  }));
}

TEST_F(ExplicitAllocator, MemoryOlderThanTheHeapIsAdopted) {
  EXPECT_TRUE(in_own_process([] {
    auto subscription = create_subscription<Track>(PlainNode(), "tracks", QoS(1));
    auto early = std::make_unique<Track>(track_of(53));
    EXPECT_EQ(agnocast_heaphook()->owns(early.get()), 0);
    auto publisher = create_publisher<Track>(PlainNode(), "tracks", 1);
    const PublishResult result = publisher->publish(std::move(early));
    ASSERT_TRUE(result) << sentence_of(result.code);
    const Track expected = track_of(53);
    std::size_t bytes = sizeof(Track) + expected.label.size() + 1 +
                        expected.cells.size() * sizeof(Cell) +
                        expected.notes.size() * sizeof(SharedString);
    for (const SharedString& note : expected.notes) bytes += note.size() + 1;
    EXPECT_EQ(result.adopted_bytes, bytes);
    const auto track = take_soon(subscription);
    ASSERT_TRUE(track);
    EXPECT_EQ(*track, expected);
    EXPECT_EQ(agnocast_heaphook()->owns(track->cells.data()), 1);
  }));
}

TEST_F(ExplicitAllocator, APauseAppliesToItToo) {
  EXPECT_TRUE(in_own_process([] {
    auto publisher = create_publisher<Track>(PlainNode(), "tracks", 1);
    SharedVector<int> shared(100);
    EXPECT_EQ(agnocast_heaphook()->owns(shared.data()), 1);
    const LoanPause pause;
    SharedVector<int> own(100);
    EXPECT_EQ(agnocast_heaphook()->owns(own.data()), 0);
    shared.clear();
    shared.shrink_to_fit();
  }));
}

/// Publishes during the destruction of static objects: the data of the main thread is gone by
/// then.
struct Farewell {
  Publisher<Track>::SharedPtr publisher;
  ~Farewell() {
    if (publisher == nullptr) return;
    for (std::uint32_t id = 1; id <= 3; ++id) {
      auto loan = publisher->borrow_loaned_message();
      fill(*loan, id);
      const PublishResult result = publisher->publish(std::move(loan));
      if (!result || result.adopted_bytes != 0) ::_exit(3);
    }
  }
};

TEST_F(ExplicitAllocator, AnExitingProcessMayStillPublish) {
  auto subscription_ready = [](int fd) { return ::write(fd, "", 1) == 1; };
  int ready[2];
  ASSERT_EQ(::pipe(ready), 0);
  Child subscriber([&]() noexcept {
    auto subscription = create_subscription<Track>(PlainNode(), "tracks", QoS(10));
    if (!subscription_ready(ready[1])) return 1;
    for (std::uint32_t id = 1; id <= 3; ++id) {
      const auto track = take_soon(subscription);
      if (!track || !(*track == track_of(id))) return 2;
    }
    return 0;
  });
  char byte = 0;
  ASSERT_EQ(::read(ready[0], &byte, 1), 1);
  Child publisher([]() noexcept -> int {
    ::alarm(60);
    static Farewell farewell;
    farewell.publisher = create_publisher<Track>(PlainNode(), "tracks", 10);
    farewell.publisher->borrow_loaned_message().reset();
    std::exit(0);
  });
  EXPECT_EQ(publisher.wait(), 0);
  EXPECT_EQ(subscriber.wait(), 0);
}

#if defined(AGNOCAST_TEST_SANITIZED)
constexpr bool malloc_is_the_sanitizers = true;
#else
constexpr bool malloc_is_the_sanitizers = false;
#endif

// All other types need malloc: every creation checks it, not only the first. A sanitizer's malloc
// is in a library (g++) or in the program itself (clang++).
TEST_F(ExplicitAllocator, OrdinaryTypesNeedTheHookInFrontOfMalloc) {
  const std::string program = std::filesystem::read_symlink("/proc/self/exe").filename();
  const std::string says =
      "malloc comes from ([^,]*/)?(lib[^/,]*san[^/,]*|" + program + "), not from ";
  EXPECT_TRUE(in_own_process([&] {
    EXPECT_TRUE(try_create_publisher<Track>(PlainNode(), "tracks", QoS(1)));
    for (int i = 0; i < 2; ++i) {
      const auto publisher = try_create_publisher<Ordinary>(PlainNode(), "ordinary", QoS(1));
      EXPECT_EQ(publisher.has_value(), !malloc_is_the_sanitizers);
      if (publisher) continue;
      EXPECT_EQ(publisher.error().code, Errc::hook_ineffective);
      EXPECT_THAT(Error(publisher.error()).what(), testing::ContainsRegex(says));
    }
  }));
}

}  // namespace
}  // namespace agnocast
