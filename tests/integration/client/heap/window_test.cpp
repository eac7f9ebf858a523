// SPDX-License-Identifier: Apache-2.0
//
// Goal: a heap whose growth was refused grows when the resources are there again, and the
// process's own subscriptions read in a window that came after they had linked.
// Method: the real daemon with small windows; in the first test with a quota of two, and another
// client has the second one and gives it back. The publisher keeps all its messages, so that only
// another window makes room. Each in a process of its own, because a process has one heap.

#include <agnocast/agnocast.hpp>
#include <tests/support/messages/bulk.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/own_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/wire/wire_client.hpp>

#include <gmock/gmock.h>

#include <cstdint>
#include <cstdlib>
#include <optional>
#include <utility>

namespace agnocast {
namespace {

namespace wire = abi::wire;
using test::Bulk;
using test::PlainNode;

void grow_after_a_refusal() {
  test::DaemonProcess daemon(
      {.config =
           "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"1GiB\"\n" AGNOCAST_TEST_ARENA_BASE
           "[quota]\nheap_bytes = \"128MiB\"\n"});
  ::setenv("AGNOCAST_SOCKET", daemon.socket_path().c_str(), 1);
  std::optional<test::WireClient> other(std::in_place, daemon.socket_path());
  ASSERT_EQ(other->hello().opcode(), wire::Opcode::welcome);
  ASSERT_EQ(other->open_window(0).opcode(), wire::Opcode::window_opened);

  auto publisher = create_publisher<Bulk>(PlainNode(), "bulk", QoS(100).transient_local());
  ipc_shared_ptr<Bulk> loan;
  PublishResult result;
  for (int i = 0; i < 64; ++i) {
    loan = publisher->borrow_loaned_message();
    loan->data.resize(4 << 20);
    result = publisher->publish(std::move(loan));
    if (!result) break;
  }
  ASSERT_EQ(result.code, Errc::heap_exhausted) << "it may grow later";
  ASSERT_TRUE(loan);
  ASSERT_TRUE(daemon.wait_for_log("[quota] heap_bytes"));
  EXPECT_EQ(publisher->publish(std::move(loan)).code, Errc::heap_exhausted);

  other.reset();
  EXPECT_TRUE(test::eventually([&] {
    result = publisher->publish(std::move(loan));
    return static_cast<bool>(result);
  })) << sentence_of(result.code);
}

void grow_while_linked() {
  test::DaemonProcess daemon(
      {.config =
           "[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"1GiB\"\n" AGNOCAST_TEST_ARENA_BASE});
  ::setenv("AGNOCAST_SOCKET", daemon.socket_path().c_str(), 1);
  const QoS qos = QoS(100).transient_local();
  auto subscriber = create_subscription<Bulk>(PlainNode(), "bulk", qos);
  auto publisher = create_publisher<Bulk>(PlainNode(), "bulk", qos);
  for (std::uint8_t number = 1; number <= 32; ++number) {  // twice the first window
    auto loan = publisher->borrow_loaned_message();
    ASSERT_TRUE(test::eventually([&] {  // the next window is on its way
      loan->data.assign(4 << 20, number);
      return static_cast<bool>(publisher->publish(std::move(loan)));
    }));
    ipc_shared_ptr<const Bulk> taken;
    ASSERT_TRUE(test::eventually([&] {
      taken = subscriber->take();
      return static_cast<bool>(taken);
    })) << "message "
        << int{number};
    EXPECT_EQ(taken->data.back(), number);
  }
  EXPECT_EQ(subscriber->get_lost_count(), 0u);
}

TEST(Window, ARefusedOneIsRequestedAgain) {
  EXPECT_TRUE(test::in_own_process(grow_after_a_refusal));
}
TEST(Window, TheProcessItselfReadsInANewOne) {
  EXPECT_TRUE(test::in_own_process(grow_while_linked));
}

}  // namespace
}  // namespace agnocast
