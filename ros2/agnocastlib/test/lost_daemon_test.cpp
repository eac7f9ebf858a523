// SPDX-License-Identifier: Apache-2.0
//
// Goal: people who ignore what publish() cannot return read in the log that agnocastd is gone.
// Method: a daemon of this test ends while a node spins, and while nothing spins.

#include "daemon.hpp"

namespace agnocastlib {
namespace {

constexpr const char* line = "the connection to agnocastd failed: daemon_not_running: ";

TEST(LostDaemonTest, IsLogged) {
  Daemon daemon;
  agnocast::init(0, nullptr);
  {
    const LogLines lines;
    const auto node = std::make_shared<agnocast::Node>("node");
    const auto publisher = node->create_publisher<String>("topic", 1);
    const auto subscription = node->create_subscription<String>("topic", 1);
    ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
    const auto start = std::chrono::steady_clock::now();
    {
      agnocast::AgnocastOnlySingleThreadedExecutor executor;
      executor.add_node(node);
      const Spinning spinning(executor);
      publish(*publisher, "before");
      EXPECT_THAT(lines.with("agnocastd"), testing::IsEmpty());
      daemon.stop();
      EXPECT_TRUE(eventually([&] { return !lines.with(line).empty(); })) << "by the node";
    }
    // Messages flow, so publish() has nothing to report of its own.
    publish(*publisher, "after");
    EXPECT_EQ(subscription->take_data()->data, "after");
    const std::size_t by_node = lines.with(line).size();
    EXPECT_TRUE(eventually([&] {
      publish(*publisher, "again");
      return lines.with(line).size() >= by_node + 2;
    })) << "without a spin";
    EXPECT_LE(lines.with(line).size(), seconds_begun_since(start));
    EXPECT_THAT(lines.with("publishing"), testing::IsEmpty());
  }
  agnocast::shutdown();
}

}  // namespace
}  // namespace agnocastlib
