// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocast-ctl reports the true counts of real processes, and verify finds nothing while
// they work at full speed and die in the middle of it. Method: the library itself (the hook is
// linked) for the counters, processes of client_tool for the traffic, SIGKILL for the deaths.

#include <agnocast/agnocast.hpp>
#include <tests/support/processes/client_tool.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <sensor_msgs/msg/point_cloud2.hpp>

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

using test::ClientTool;
using test::CtlResult;
using test::DaemonProcess;
using test::PlainNode;
using test::run_ctl;
using Cloud = sensor_msgs::msg::PointCloud2;

TEST(CtlLive, CountsAdoptedAndLostMessages) {
  DaemonProcess daemon;
  ::setenv("AGNOCAST_SOCKET", daemon.socket_path().c_str(), 1);
  PlainNode node;
  auto publisher = create_publisher<Cloud>(node, "/points", QoS(2));
  auto subscription = create_subscription<Cloud>(node, "/points", QoS(2));
  const auto info = [&] {
    return run_ctl(daemon.socket_path(), {"topic", "info", "/points", "-j"}).json();
  };
  ASSERT_TRUE(
      test::eventually([&] { return info()["subscriptions"][0]["linked_publishers"] == 1; }));
  EXPECT_EQ(info()["publishers"][0]["is_zero_copy"], true);
  EXPECT_EQ(info()["publishers"][0]["node_name"], "node");
  EXPECT_EQ(info()["publishers"][0]["node_namespace"], "/ns");
  auto loan = publisher->borrow_loaned_message();
  loan->data.resize(1000);
  ASSERT_TRUE(publisher->publish(std::move(loan)));
  EXPECT_EQ(info()["publishers"][0]["adopted_messages"], 0) << "a loan is not adopted";
  std::uint64_t adopted = 0;
  for (int i = 0; i < 4; ++i) {
    auto foreign = std::make_unique<Cloud>();  // on the ordinary heap
    foreign->data.resize(5000);
    const PublishResult result = publisher->publish(std::move(foreign));
    ASSERT_TRUE(result);
    adopted += result.adopted_bytes;
  }
  ASSERT_GT(adopted, 20000u);
  EXPECT_EQ(info()["publishers"][0]["published_messages"], 5);
  EXPECT_EQ(info()["publishers"][0]["adopted_messages"], 4);
  EXPECT_EQ(info()["publishers"][0]["adopted_bytes"], adopted);
  EXPECT_EQ(info()["publishers"][0]["is_zero_copy"], false);
  auto first = subscription->take();
  auto second = subscription->take();
  EXPECT_TRUE(first && second && !subscription->take());
  EXPECT_EQ(info()["subscriptions"][0]["lost_messages"], 3) << "five came, two fit its depth";
  EXPECT_EQ(info()["subscriptions"][0]["held_messages"], 2);
  EXPECT_EQ(info()["publishers"][0]["held_messages"], 2);
  first.reset();
  EXPECT_EQ(info()["subscriptions"][0]["held_messages"], 1);

  // A subscription that must not lose anything and reads nothing: publish returns would_block.
  auto keeper = create_subscription<Cloud>(node, "/kept", QoS(1).keep_all(2));
  auto hasty = create_publisher<Cloud>(node, "/kept", QoS(1).keep_all(2));
  const auto kept = [&] {
    return run_ctl(daemon.socket_path(), {"topic", "info", "/kept", "-j"}).json()["publishers"][0];
  };
  ASSERT_TRUE(test::eventually([&] { return hasty->get_linked_subscription_count() == 1; }));
  int refused = 0;
  for (int i = 0; i < 5; ++i) {
    const PublishResult result = hasty->publish(std::make_unique<Cloud>());
    if (!result) {
      EXPECT_EQ(result.code, Errc::would_block);
      ++refused;
    }
  }
  EXPECT_GT(refused, 0);
  EXPECT_EQ(kept()["refused_would_block"], refused);
  EXPECT_EQ(kept()["published_messages"], 5 - refused);
}

TEST(CtlLive, CountsMessagesLostBeyondADepthInAnotherProcess) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  ASSERT_EQ(subscriber.ask("sub /points 3"), "ok");
  ASSERT_EQ(publisher.ask("pub /points 1"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  ASSERT_TRUE(subscriber.eventually("links", "1"));
  ASSERT_EQ(publisher.ask("publish 10 10"), "ok");
  EXPECT_NE(subscriber.ask("take"), "none");
  const std::string lost = subscriber.ask("lost");
  const auto info = run_ctl(daemon.socket_path(), {"topic", "info", "/points", "-j"}).json();
  EXPECT_EQ(std::to_string(info["subscriptions"][0]["lost_messages"].get<int>()), lost);
  EXPECT_EQ(lost, "7");
  EXPECT_EQ(info["subscriptions"][0]["unread_messages"], 2);
  EXPECT_EQ(info["publishers"][0]["published_messages"], 10);
}

TEST(CtlLive, VerifyFindsNothingUnderTrafficAndDeaths) {
  DaemonProcess daemon;
  std::atomic<bool> stop{false};
  std::atomic<std::uint64_t> published{0}, taken{0}, deaths{0};
  // Each thread steers one process after the other: it works for a while, then is killed in the
  // middle of a command.
  const auto publish = [&](int number) {
    for (int life = 0; !stop; ++life) {
      ClientTool tool(daemon.socket_path());
      const std::string depth = std::to_string(1 + (number + life) % 5);
      if (tool.ask("pub /busy" + std::to_string(number % 2) + " " + depth) != "ok") continue;
      for (int i = 0; i < 40 && !stop; ++i) {
        if (tool.ask("publish 50 20") == "ok") published += 50;
      }
      tool.tell("publish 100000 20");
      std::this_thread::sleep_for(std::chrono::milliseconds(30 + life % 5 * 7));
      tool.kill();
      ++deaths;
    }
  };
  const auto subscribe = [&](int number) {
    for (int life = 0; !stop; ++life) {
      ClientTool tool(daemon.socket_path());
      const std::string depth = std::to_string(3 + number);
      if (tool.ask("sub /busy" + std::to_string(number % 2) + " " + depth) != "ok") continue;
      for (int i = 0; i < 300 && !stop; ++i) {
        const std::string number_taken = tool.ask("take");
        if (number_taken == "none") {
          tool.ask("wait 10");
        } else {
          EXPECT_NE(number_taken, "damaged");
          ++taken;
          if (i % 3 != 0) {
            EXPECT_EQ(tool.ask("release"), "ok");
          }
        }
      }
      tool.kill();
      ++deaths;
    }
  };
  std::vector<std::thread> threads;
  for (int i = 0; i < 2; ++i) threads.emplace_back(publish, i);
  for (int i = 0; i < 3; ++i) threads.emplace_back(subscribe, i);
  std::uint64_t verdicts = 0, queues = 0, links = 0;
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(8);
  while (std::chrono::steady_clock::now() < end || verdicts < 5) {
    const CtlResult result = run_ctl(daemon.socket_path(), {"verify", "-j"});
    EXPECT_EQ(result.status, 0) << result.out << result.err;
    if (result.status != 0) break;
    ++verdicts;
    queues += result.json()["queues"].get<std::uint64_t>();
    links += result.json()["links"].get<std::uint64_t>();
  }
  stop = true;
  for (std::thread& thread : threads) thread.join();
  std::printf(
      "%llu verdicts over %llu queues and %llu links; %llu published, %llu taken, %llu deaths\n",
      static_cast<unsigned long long>(verdicts), static_cast<unsigned long long>(queues),
      static_cast<unsigned long long>(links), static_cast<unsigned long long>(published.load()),
      static_cast<unsigned long long>(taken.load()),
      static_cast<unsigned long long>(deaths.load()));
  EXPECT_GT(queues, 0u);
  EXPECT_GT(links, 0u);
  EXPECT_GT(taken.load(), 0u);
  EXPECT_GT(deaths.load(), 0u);
  const CtlResult last = run_ctl(daemon.socket_path(), {"verify"});
  EXPECT_EQ(last.status, 0) << last.out;
}

}  // namespace
}  // namespace agnocast
