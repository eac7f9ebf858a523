// SPDX-License-Identifier: Apache-2.0
//
// Goal: a watch of the graph has what the daemon announces, tells each change, and ends while it
// waits. Method: endpoints of this process come and go, with the real daemon.

#include <ros2/rmw_agnocast_cpp/core/graph_watch.hpp>

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <string>
#include <thread>

namespace agnocast::rmw {
namespace {

using agnocast::test::eventually;
using agnocast::test::Number;

class GraphWatches : public agnocast::test::SuiteDaemon {
 protected:
  static std::ptrdiff_t count(GraphWatch& watch, const std::string& topic) {
    const auto snapshot = watch.now();
    return std::count_if(snapshot->endpoints.begin(), snapshot->endpoints.end(),
                         [&](const EndpointInfo& endpoint) { return endpoint.topic == topic; });
  }
};

TEST_F(GraphWatches, SeeWhatComesAndGoes) {
  Node node(own("node"));
  const std::string topic = "/" + own("topic");
  std::atomic<int> changes{0};
  GraphWatch watch(0, [&] { ++changes; });
  EXPECT_EQ(count(watch, topic), 0);
  for (int i = 0; i < 3; ++i) {
    const int before = changes;
    {
      const auto publisher = node.create_publisher<Number>(topic, 1);
      const auto subscription = node.create_subscription<Number>(topic, 1);
      ASSERT_TRUE(eventually([&] { return count(watch, topic) == 2; }));
    }
    ASSERT_TRUE(eventually([&] { return count(watch, topic) == 0; }));
    ASSERT_TRUE(eventually([&] { return changes > before; }));
  }
}

TEST_F(GraphWatches, HaveWhatThisProcessHasJustDone) {
  Node node(own("node"));
  const std::string topic = "/" + own("topic");
  std::atomic<int> changes{0};
  GraphWatch watch(0, [&] { ++changes; });
  ASSERT_TRUE(eventually([&] { return watch.now()->incarnation != 0 && changes != 0; }));
  for (int i = 0; i < 100; ++i) {
    const int before = changes;
    auto publisher = node.create_publisher<Number>(topic, 1);
    ASSERT_EQ(count(watch, topic), 1) << i;
    const auto now = watch.now();
    for (const EndpointInfo& endpoint : now->endpoints) ASSERT_TRUE(endpoint.is_own);
    auto subscription = node.create_subscription<Number>(topic, 1);
    ASSERT_EQ(count(watch, topic), 2) << i;
    publisher.reset();
    ASSERT_EQ(count(watch, topic), 1) << i;
    subscription.reset();
    ASSERT_EQ(count(watch, topic), 0) << i;
    // Though somebody has looked.
    ASSERT_TRUE(eventually([&] { return changes > before; })) << i;
  }
}

TEST_F(GraphWatches, HaveOneDomain) {
  Node node(own("node"));
  const std::string topic = "/" + own("topic");
  const auto publisher = node.create_publisher<Number>(topic, 1);
  std::atomic<int> changes{0}, changes_here{0};
  GraphWatch here(0, [&] { ++changes_here; }), elsewhere(1, [&] { ++changes; });
  ASSERT_TRUE(eventually([&] { return count(here, topic) == 1; }));
  EXPECT_EQ(count(elsewhere, topic), 0);
  ASSERT_TRUE(eventually([&] { return changes == 1; })) << "its first state";
  // A change of its domain would be reported with the second of these at the latest: both watches
  // are woken for each.
  for (int i = 0; i < 2; ++i) {
    const int before = changes_here;
    const auto subscription = node.create_subscription<Number>(topic, 1);
    ASSERT_TRUE(eventually([&] { return changes_here > before; }));
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_EQ(changes, 1) << "nothing of its domain has changed";
}

TEST_F(GraphWatches, EndWhileTheyWait) {
  for (int i = 0; i < 20; ++i) {
    GraphWatch watch(0, [] {});
    if (i % 2 == 0) (void)watch.now();
  }
}

}  // namespace
}  // namespace agnocast::rmw
