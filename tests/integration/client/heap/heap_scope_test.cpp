// SPDX-License-Identifier: Apache-2.0
//
// Goal: a program chooses which of its allocations are shared: those of its loans, or all; and
// messages in other memory are adopted and counted.
// Method: one process per case (the scope is chosen once), publisher and subscription in it, the
// real daemon and hook, a message type of rosidl.

#include <agnocast/agnocast.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/own_process.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <sensor_msgs/msg/point_cloud2.hpp>

#include <gmock/gmock.h>

#include <cstdlib>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using Cloud = sensor_msgs::msg::PointCloud2;
using test::in_own_process;
using test::PlainNode;
using test::take_soon;

class HeapScopes : public testing::Test {
 protected:
  void SetUp() override {
    ::setenv("AGNOCAST_SOCKET", daemon_.socket_path().c_str(), 1);
    ::unsetenv("AGNOCAST_SCOPE");
  }
  void TearDown() override { ::unsetenv("AGNOCAST_SCOPE"); }
  test::DaemonProcess daemon_;
  PlainNode node_;
};

/// Runs it in another thread, so that no loan of the caller is open there.
template <class Make>
auto made_elsewhere(Make make) {
  decltype(make()) made;
  std::thread([&] { made = make(); }).join();
  return made;
}

std::unique_ptr<Cloud> large_cloud() {
  auto cloud = std::make_unique<Cloud>();
  cloud->header.frame_id = "a frame whose name does not fit into a string object";
  cloud->fields.resize(2);
  cloud->fields[1].name = "a field whose name does not fit into a string object";
  cloud->data.assign(100000, 7);
  return cloud;
}

/// Returns a vector with spare capacity, as drivers do.
std::vector<std::uint8_t> from_a_driver() {
  std::vector<std::uint8_t> bytes;
  bytes.reserve(50000);
  bytes.assign(30000, 9);
  return bytes;
}

void expect_all_shared(PlainNode& node) {
  auto subscription = create_subscription<Cloud>(node, "points", QoS(5));
  auto publisher = create_publisher<Cloud>(node, "points", 5);
  auto cloud = made_elsewhere(large_cloud);
  const Cloud* const address = cloud.get();
  const PublishResult made_anywhere = publisher->publish(std::move(cloud));
  ASSERT_TRUE(made_anywhere) << sentence_of(made_anywhere.code);
  EXPECT_EQ(made_anywhere.adopted_bytes, 0u);
  const auto received = take_soon(subscription);
  ASSERT_TRUE(received);
  EXPECT_EQ(received.get(), address) << "no byte moved";
  EXPECT_EQ(*received, *large_cloud());

  auto bytes = made_elsewhere(from_a_driver);
  const std::uint8_t* const payload = bytes.data();
  auto loan = publisher->borrow_loaned_message();
  loan->data = std::move(bytes);
  const PublishResult moved_in = publisher->publish(std::move(loan));
  ASSERT_TRUE(moved_in);
  EXPECT_EQ(moved_in.adopted_bytes, 0u);
  EXPECT_EQ(take_soon(subscription)->data.data(), payload);
}

void expect_loans_shared(PlainNode& node) {
  auto subscription = create_subscription<Cloud>(node, "points", QoS(5));
  auto publisher = create_publisher<Cloud>(node, "points", 5);
  auto bytes = made_elsewhere(from_a_driver);
  auto loan = publisher->borrow_loaned_message();
  loan->data = std::move(bytes);
  const PublishResult moved_in = publisher->publish(std::move(loan));
  ASSERT_TRUE(moved_in);
  EXPECT_EQ(moved_in.adopted_bytes, 30000u) << "its size, not its capacity";
  EXPECT_EQ(take_soon(subscription)->data, from_a_driver());

  auto cloud = made_elsewhere(large_cloud);
  const std::uint64_t text_bytes = cloud->header.frame_id.size() + cloud->fields[1].name.size() + 2;
  const PublishResult made_anywhere = publisher->publish(std::move(cloud));
  ASSERT_TRUE(made_anywhere);
  EXPECT_EQ(made_anywhere.adopted_bytes,
            sizeof(Cloud) + 100000 + 2 * sizeof(sensor_msgs::msg::PointField) + text_bytes);
  EXPECT_EQ(*take_soon(subscription), *large_cloud());
}

TEST_F(HeapScopes, LoanIsTheDefaultAndAVectorMovedInIsAdoptedByItsSize) {
  EXPECT_TRUE(in_own_process([&] { expect_loans_shared(node_); }));
}

TEST_F(HeapScopes, WithAllAMessageMadeAnywhereIsPublishedWithoutACopy) {
  EXPECT_TRUE(in_own_process([&] {
    ASSERT_TRUE(set_heap_scope(HeapScope::all));
    expect_all_shared(node_);
  }));
}

TEST_F(HeapScopes, TheEnvironmentOverridesTheProgram) {
  EXPECT_TRUE(in_own_process([&] {
    ::setenv("AGNOCAST_SCOPE", "all", 1);
    ASSERT_TRUE(set_heap_scope(HeapScope::loan));
    expect_all_shared(node_);
  }));
  EXPECT_TRUE(in_own_process([&] {
    ::setenv("AGNOCAST_SCOPE", "loan", 1);
    ASSERT_TRUE(set_heap_scope(HeapScope::all));
    expect_loans_shared(node_);
  }));
}

TEST_F(HeapScopes, MemoryAllocatedBeforeTheFirstPublisherStaysPrivateWithAll) {
  EXPECT_TRUE(in_own_process([&] {
    ASSERT_TRUE(set_heap_scope(HeapScope::all));
    auto early = large_cloud();
    auto publisher = create_publisher<Cloud>(node_, "points", 5);
    const PublishResult result = publisher->publish(std::move(early));
    ASSERT_TRUE(result);
    EXPECT_GT(result.adopted_bytes, 100000u);
  }));
}

TEST_F(HeapScopes, AnInvalidValueIsNamedAndTheNextTryMayUseAValidOne) {
  EXPECT_TRUE(in_own_process([&] {
    ::setenv("AGNOCAST_SCOPE", "everything", 1);
    const auto refused = try_create_publisher<Cloud>(node_, "points", QoS(1));
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, Errc::invalid_argument);
    EXPECT_STREQ(detail_of(refused.error()),
                 "AGNOCAST_SCOPE is \"everything\", which is neither loan nor all");
    EXPECT_TRUE(try_create_subscription<Cloud>(node_, "points", QoS(1)))
        << "a process that only subscribes has no heap and no scope";
    ::setenv("AGNOCAST_SCOPE", "", 1);
    EXPECT_TRUE(try_create_publisher<Cloud>(node_, "points", QoS(1)));
  }));
}

TEST_F(HeapScopes, TheScopeIsFixedAfterTheFirstPublisher) {
  EXPECT_TRUE(in_own_process([&] {
    auto publisher = create_publisher<Cloud>(node_, "points", 1);
    const Result<void> refused = set_heap_scope(HeapScope::all);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, Errc::invalid_argument);
    EXPECT_TRUE(set_heap_scope(HeapScope::loan)) << "it is the current scope";
  }));
}

}  // namespace
}  // namespace agnocast
