// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process with other memory in the arena gets its messages all the same: from the start
// when its mapping came first, from then on when it joins later; no other process notices, and
// messages that it cannot get are counted and reported.
// Method: the real daemon with an arena of a few small windows at a known address; processes of
// client_tool, with the hook, that map a page there before their first endpoint (a JIT's, say).
// For a message begun before the heap moved, this program publishes through the public interface
// and bad_input_node reads.

#include <agnocast/abi/limits.hpp>
#include <agnocast/agnocast.hpp>
#include <tests/support/processes/client_tool.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/shell.hpp>

#include <gmock/gmock.h>

#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <deque>
#include <future>
#include <string>

namespace agnocast {
namespace {

using test::ClientTool;
using test::DaemonProcess;
using testing::HasSubstr;

constexpr std::uint64_t arena = 0x3000'0000'0000;
constexpr std::uint64_t window = 64 << 20;
constexpr const char* small_arena =
    "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"1GiB\"\narena_base = 0x300000000000\n";

std::string occupy(std::uint64_t number, std::uint64_t bytes = 4096) {
  return "occupy " + std::to_string(arena + number * window + window / 2) + " " +
         std::to_string(bytes);
}
/// A message may ring before its window is announced here; then it stays unread until the window
/// rings.
std::string take(ClientTool& tool) {
  for (;;) {
    if (const std::string rung = tool.ask("wait 10000"); rung != "news") return rung;
    if (std::string number = tool.ask("take"); number != "none") return number;
  }
}

/// Returns the window in which the oldest held message of a tool lies.
std::uint64_t window_of(ClientTool& tool) {
  return (std::stoull(tool.ask("address")) - arena) / window;
}

TEST(Addresses, AHeapAvoidsRangesThatWereOccupiedBeforeIt) {
  DaemonProcess daemon({.config = small_arena});
  ClientTool subscriber(daemon.socket_path()), publisher(daemon.socket_path());
  ASSERT_EQ(subscriber.ask(occupy(0)), "ok");
  ASSERT_EQ(subscriber.ask(occupy(2)), "ok");
  ASSERT_EQ(subscriber.ask("sub /points 5"), "ok");
  ASSERT_TRUE(daemon.wait_for_log("addresses blocked"));
  ASSERT_EQ(publisher.ask("pub /points 1"), "ok");
  ASSERT_EQ(publisher.ask("publish 2 100000"), "ok");
  for (const char* number : {"1", "2"}) {
    ASSERT_EQ(take(subscriber), number);
  }
  EXPECT_EQ(window_of(subscriber), 1u);
  EXPECT_EQ(subscriber.ask("lost"), "0");
  ClientTool next(daemon.socket_path());
  ASSERT_EQ(next.ask("pub /points 1"), "ok");
  ASSERT_EQ(next.ask("publish 1 10"), "ok");
  ASSERT_EQ(take(subscriber), "1") << "a message of the second publisher, in window 3";
}

TEST(Addresses, APublisherAvoidsItsOwnOccupiedRanges) {
  DaemonProcess daemon({.config = small_arena});
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  ASSERT_EQ(publisher.ask(occupy(0, 3 * window)), "ok");
  ASSERT_EQ(subscriber.ask("sub /points 5"), "ok");
  ASSERT_EQ(publisher.ask("pub /points 1"), "ok");
  ASSERT_EQ(publisher.ask("publish 1 100000"), "ok");
  ASSERT_EQ(take(subscriber), "1");
  EXPECT_EQ(window_of(subscriber), 4u);
}

TEST(Addresses, AJoinerWithAnOccupiedRangeGetsMessagesFromThenOn) {
  DaemonProcess daemon({.config = small_arena});
  ClientTool publisher(daemon.socket_path()), other(daemon.socket_path()),
      joiner(daemon.socket_path());
  ASSERT_EQ(other.ask("sub /points 20"), "ok");
  ASSERT_EQ(publisher.ask("pub /points 20 tl"), "ok");
  ASSERT_EQ(publisher.ask("publish 3 100000"), "ok");
  ASSERT_EQ(take(other), "1");
  ASSERT_EQ(window_of(other), 0u);

  ASSERT_EQ(joiner.ask(occupy(0)), "ok");
  ASSERT_EQ(joiner.ask("sub /points 20 tl"), "ok");
  ASSERT_TRUE(daemon.wait_for_log("heap collides"));
  EXPECT_THAT(daemon.log(), HasSubstr("it goes on in another window"));
  EXPECT_THAT(daemon.log(), HasSubstr("300002000000-300002001000 r--p"))
      << "the mapping that lies there";
  ASSERT_TRUE(publisher.eventually("first_window", "1"));
  ASSERT_EQ(publisher.ask("publish 3 100000"), "ok");

  for (const char* number : {"4", "5", "6"}) {
    ASSERT_EQ(take(joiner), number);
    EXPECT_EQ(window_of(joiner), 1u);
    ASSERT_EQ(joiner.ask("release"), "ok");
  }
  EXPECT_EQ(joiner.ask("take"), "none");
  EXPECT_EQ(joiner.ask("lost"), "3") << "its history lies where it has another mapping";
  EXPECT_EQ(joiner.ask("unreachable"), "3");
  EXPECT_EQ(joiner.ask("malformed"), "0");
  for (const char* number : {"2", "3", "4", "5", "6"}) ASSERT_EQ(take(other), number);
  EXPECT_EQ(other.ask("lost"), "0");
  for (int i = 0; i < 6; ++i) EXPECT_EQ(other.ask("release"), "ok");
}

TEST(Addresses, EveryJoinerIsServedUntilTheHeapHasMovedOftenEnough) {
  DaemonProcess daemon({.config = small_arena});
  ClientTool publisher(daemon.socket_path());
  ASSERT_EQ(publisher.ask("pub /points 1"), "ok");
  std::deque<ClientTool> joiners;
  for (std::uint64_t move = 0; move < abi::heap_move_max; ++move) {
    ClientTool& joiner = joiners.emplace_back(daemon.socket_path());
    ASSERT_EQ(joiner.ask(occupy(move)), "ok");
    ASSERT_EQ(joiner.ask("sub /points 5"), "ok");
    ASSERT_TRUE(publisher.eventually("first_window", std::to_string(move + 1).c_str()));
    ASSERT_TRUE(publisher.eventually("matched", std::to_string(move + 1).c_str()));
    ASSERT_EQ(publisher.ask("publish 1 1000"), "ok");
    for (ClientTool& one : joiners) {
      ASSERT_EQ(take(one), std::to_string(move + 1));
    }
  }
  ClientTool& late = joiners.emplace_back(daemon.socket_path());
  ASSERT_EQ(late.ask(occupy(abi::heap_move_max)), "ok");
  ASSERT_EQ(late.ask("sub /points 5"), "ok");
  ASSERT_TRUE(daemon.wait_for_log("it stays: it has moved 3 times"));
}

TEST(Addresses, AHeapThatCannotMoveSaysWhyAndServesTheOthers) {
  DaemonProcess daemon({.config = std::string(small_arena) + "windows_per_process = 1\n"});
  ClientTool publisher(daemon.socket_path()), other(daemon.socket_path()),
      joiner(daemon.socket_path());
  ASSERT_EQ(publisher.ask("pub /points 1"), "ok");
  ASSERT_EQ(other.ask("sub /points 100"), "ok");
  ASSERT_EQ(joiner.ask(occupy(0)), "ok");
  ASSERT_EQ(joiner.ask("sub /points 100"), "ok");
  ASSERT_TRUE(daemon.wait_for_log("it stays: [heap] windows_per_process is 1"));
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 50 100"), "ok");
  EXPECT_EQ(joiner.ask("take"), "none");
  EXPECT_EQ(joiner.ask("unreachable"), "50");
  EXPECT_EQ(joiner.ask("lost"), "50");
  EXPECT_EQ(joiner.ask("wait 50"), "timeout") << "it sleeps instead of retrying";
  for (int i = 1; i <= 50; ++i) {
    ASSERT_EQ(other.ask("take"), std::to_string(i));
    ASSERT_EQ(other.ask("release"), "ok");
  }
  EXPECT_TRUE(publisher.eventually("allocated", "0")) << "no reader holds a lost message";
}

// Processes block all but one window, and one process of this user blocks half of the arena.
TEST(Addresses, AWindowIsFoundWhereTheFewestProcessesHaveMappings) {
  DaemonProcess daemon({.config = small_arena});
  ClientTool first(daemon.socket_path()), second(daemon.socket_path()),
      publisher(daemon.socket_path());
  ASSERT_EQ(first.ask("occupy " + std::to_string(arena) + " " + std::to_string(9 * window)), "ok");
  ASSERT_EQ(second.ask("occupy " + std::to_string(arena) + " " + std::to_string(8 * window)), "ok");
  ASSERT_EQ(first.ask("sub /points 5"), "ok");
  ASSERT_EQ(second.ask("sub /points 5"), "ok");
  ASSERT_EQ(publisher.ask("pub /points 1"), "ok");
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  ASSERT_EQ(take(second), "1");
  EXPECT_EQ(window_of(second), 8u) << "others do not avoid as many as nine windows of one user";
  ASSERT_TRUE(daemon.wait_for_log("it stays: the reader's user blocks too much"));
}

struct Text {
  std::string data;
};

}  // namespace

template <>
struct MessageTraits<Text> {
  static constexpr const char* name = "test/Text";
  static void for_each_pointer(const Text& text, PointerVisitor& visit) noexcept {
    visit("data", text.data);
  }
};

namespace {

/// Returns the output of a bad_input_node that subscribes and gets one message.
std::string read_one(const std::string& arguments) {
  return test::run_in_shell("timeout 60 " AGNOCAST_NODE " " + arguments + " 2>&1").text;
}

// Either its object lies in the previous window, or the object lies in the new one and its target
// does not.
TEST(Addresses, AMessageBegunBeforeTheHeapMovedIsCopied) {
  DaemonProcess daemon({.config = small_arena});
  ::setenv("AGNOCAST_SOCKET", daemon.socket_path().c_str(), 1);
  auto publisher = create_publisher<Text>(test::PlainNode(), "/topic", QoS(1));
  auto begun = publisher->borrow_loaned_message();
  begun->data.assign(100'000, 'x');
  auto moved_in = publisher->borrow_loaned_message();
  moved_in->data.assign(200'000, 'x');

  const auto next_window = [&] {
    auto probe = publisher->borrow_loaned_message();
    return reinterpret_cast<std::uint64_t>(probe.get()) >= arena + window;
  };
  EXPECT_FALSE(next_window());
  auto reader = std::async(std::launch::async, [] {
    return read_one("depth=5 occupy=0x300000200000 sub take=100000 take=200000");
  });
  ASSERT_TRUE(test::eventually(next_window));
  const HeapCollisionInfo told = publisher->get_heap_collision_status();
  EXPECT_EQ(told.total_count, 1);
  EXPECT_THAT(told.last_text,
              HasSubstr("cannot map heap window 0 of process " + std::to_string(::getpid()) +
                        "; it goes on in another window; it has another mapping at "
                        "0x0000300000200000, 2097152 bytes: 300000200000-300000201000 r--p"));
  EXPECT_EQ(publisher->get_heap_collision_status().total_count_change, 0);
  ASSERT_TRUE(test::eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  PublishResult result = publisher->publish(std::move(begun));
  ASSERT_TRUE(result) << sentence_of(result.code);
  EXPECT_GE(result.adopted_bytes, 100'000u);
  auto fresh = publisher->borrow_loaned_message();
  fresh->data = std::move(moved_in->data);
  result = publisher->publish(std::move(fresh));
  ASSERT_TRUE(result) << sentence_of(result.code);
  EXPECT_GE(result.adopted_bytes, 200'000u);
  EXPECT_EQ(reader.get(), "received 100000 bytes\nreceived 200000 bytes\n");
}

}  // namespace
}  // namespace agnocast
