// SPDX-License-Identifier: Apache-2.0
//
// Goal: a heap that was refused to grow grows when what it needs is there again.
// Method: the real daemon with a heap quota of two small windows; another client has the second one
// and gives it back. The publisher keeps all it has published, so that only another window makes room.

#include <agnocast/agnocast.hpp>
#include <tests/support/daemon_process.hpp>
#include <tests/support/plain_node.hpp>
#include <tests/support/wire_client.hpp>

#include <gmock/gmock.h>

#include <cstdint>
#include <cstdlib>
#include <optional>
#include <utility>

namespace agnocast {
namespace {

namespace wire = abi::wire;
using test::PlainNode;

struct Bulk : SharedMessage {
  SharedVector<std::uint8_t> data;
};

}  // namespace

template <>
struct MessageTraits<Bulk> {
  static constexpr const char* name = "tests/Bulk";
  static void for_each_pointer(const Bulk& bulk, PointerVisitor& visit) noexcept {
    visit("data", bulk.data);
  }
};

namespace {

TEST(Window, ARefusedOneIsAskedForAgain) {
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
  ASSERT_EQ(result.code, Errc::heap_exhausted) << "it may grow one day";
  ASSERT_TRUE(loan);
  ASSERT_TRUE(daemon.wait_for_log("[quota] heap_bytes"));
  EXPECT_EQ(publisher->publish(std::move(loan)).code, Errc::heap_exhausted);

  other.reset();
  EXPECT_TRUE(test::eventually([&] {
    result = publisher->publish(std::move(loan));
    return static_cast<bool>(result);
  })) << sentence_of(result.code);
}

}  // namespace
}  // namespace agnocast
