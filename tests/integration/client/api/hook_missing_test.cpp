// SPDX-License-Identifier: Apache-2.0
//
// Goal: without the heap hook nothing can be published, whatever the message type; subscriptions
// and the shared allocator work.
// Method: this program has no hook.

#include <agnocast/agnocast.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <gmock/gmock.h>

#include <cstdlib>
#include <memory>

namespace agnocast {
namespace {

struct Number {
  int value;
};
struct OwnMemory : SharedMessage {
  int value;
};

}  // namespace

template <>
struct MessageTraits<Number> {
  static constexpr const char* name = "tests/Number";
};
template <>
struct MessageTraits<OwnMemory> {
  static constexpr const char* name = "tests/OwnMemory";
};

namespace {

TEST(HookMissing, IsReportedToPublishersAndSubscriptionsNeedNone) {
  test::DaemonProcess daemon;
  ::setenv("AGNOCAST_SOCKET", daemon.socket_path().c_str(), 1);
  for (int i = 0; i < 2; ++i) {
    const auto publisher = try_create_publisher<Number>(test::PlainNode(), "n", QoS(1));
    ASSERT_FALSE(publisher);
    EXPECT_EQ(publisher.error().code, Errc::hook_missing);
    const auto own = try_create_publisher<OwnMemory>(test::PlainNode(), "o", QoS(1));
    ASSERT_FALSE(own) << "its memory needs the hook, too";
    EXPECT_EQ(own.error().code, Errc::hook_missing);
    EXPECT_TRUE(try_create_subscription<Number>(test::PlainNode(), "n", QoS(1)));
  }
  SharedVector<int> ordinary(1000, 7);
  EXPECT_EQ(ordinary[999], 7) << "the allocator uses the ordinary heap where no shared heap exists";
  EXPECT_NE(std::make_unique<OwnMemory>(), nullptr);
}

}  // namespace
}  // namespace agnocast
