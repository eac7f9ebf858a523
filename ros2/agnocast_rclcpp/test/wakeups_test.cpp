// SPDX-License-Identifier: Apache-2.0
//
// Goal: in rclcpp's executors no message waits for ever, none comes twice, and an idle node sleeps.
// Method: each message is published after a random pause and must reach its callback before the
// next one; meanwhile callbacks keep the group busy, the node moves between executors, spins are
// cancelled, and agnocastd is killed again and again. Nothing but the message wakes the executor,
// and agnocast-guard does not ask the groups by itself here, so a wake-up that gets lost shows as a
// message that never comes.
// AGNOCAST_TEST_WAKEUPS: how many messages for each executor (default 5000).

#include "../src/guard_thread.hpp"
#include "test_node.hpp"

#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <mutex>
#include <random>
#include <string>

namespace agnocast_rclcpp {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

std::uint64_t wanted_wakeups() {
  const char* const text = std::getenv("AGNOCAST_TEST_WAKEUPS");
  return text != nullptr ? std::strtoull(text, nullptr, 10) : 5'000;
}

/// Kills the daemon's process, which its supervisor starts again. Returns whether there was one.
bool kill_daemon() {
  const char* const given = std::getenv("AGNOCAST_TEST_DAEMON");
  const std::string supervisor = given != nullptr ? given : "";
  std::ifstream children("/proc/" + supervisor + "/task/" + supervisor + "/children");
  pid_t worker = 0;
  return children >> worker && ::kill(worker, SIGKILL) == 0;
}

/// Spins one executor after the other, each for a while, and moves the node along.
class Mover {
 public:
  Mover(const ExecutorKind& kind, rclcpp::Node::SharedPtr node)
      : kind_(kind), node_(std::move(node)), thread_([this] { run(); }) {}
  ~Mover() {
    ends_ = true;
    // rclcpp forgets a cancel() that comes before the spin.
    while (!has_ended_) {
      cancel();
      std::this_thread::sleep_for(1ms);
    }
    thread_.join();
  }
  /// Ends the present spin; another one begins, in the same executor or in a new one.
  void cancel() {
    const std::lock_guard lock(mutex_);
    if (executor_ != nullptr) executor_->cancel();
  }
  std::uint64_t spins() const { return spins_; }

 private:
  void run() {
    while (!ends_) {
      if (spins_ % 4 == 0) {
        const std::lock_guard lock(mutex_);
        if (executor_ != nullptr) executor_->remove_node(node_);
        executor_ = kind_.make();
        executor_->add_node(node_);
      }
      ++spins_;
      executor_->spin();
      release_groups();
    }
    executor_->remove_node(node_);
    has_ended_ = true;
  }

  /// Humble's multi-threaded executor that is cancelled between the choice of a callback and its
  /// start drops the callback and leaves its group taken: nothing of the group would run again,
  /// rclcpp's own timers neither (Executor::execute_any_executable, MultiThreadedExecutor::run).
  void release_groups() {
    node_->for_each_callback_group(
        [](const auto& group) { group->can_be_taken_from().store(true); });
  }

  const ExecutorKind& kind_;
  rclcpp::Node::SharedPtr node_;
  std::mutex mutex_;
  std::unique_ptr<rclcpp::Executor> executor_;
  std::atomic<bool> ends_{false}, has_ended_{false};
  std::atomic<std::uint64_t> spins_{0};
  std::thread thread_;
};

class WakeupsTest : public RclcppTest, public testing::WithParamInterface<const ExecutorKind*> {};

TEST_P(WakeupsTest, NoneIsLostOrDoubled) {
  const auto node = std::make_shared<rclcpp::Node>("woken");
  std::atomic<std::uint64_t> heard{0}, doubled{0}, skipped{0};
  const auto subscription = agnocast::create_subscription<String>(
      node, "numbers", rclcpp::QoS(10),
      [&](const agnocast::ipc_shared_ptr<const String>&, const agnocast::MessageInfo& info) {
        const std::uint64_t expected = heard + 1;
        if (info.sequence < expected) ++doubled;
        if (info.sequence > expected) ++skipped;
        heard = info.sequence;
        // Keeps the group busy a third of the time, also when the next message comes.
        if (info.sequence % 4 == 0) std::this_thread::sleep_for(1ms);
      });
  const auto driver = std::make_shared<rclcpp::Node>("driver");
  const auto publisher = agnocast::create_publisher<String>(driver, "numbers", rclcpp::QoS(10));
  ASSERT_TRUE(eventually([&] { return publisher->get_subscription_count() == 1; }));
  std::mt19937_64 random(1);
  std::uint64_t daemons = 0;
  GuardThread::instance().look_each(1h);
  std::this_thread::sleep_for(2s);  // the look that it is about to do
  {
    Mover mover(*GetParam(), node);
    for (std::uint64_t number = 1; number <= wanted_wakeups(); ++number) {
      const auto end = Clock::now() + std::chrono::microseconds(random() % 300);
      while (Clock::now() < end) std::this_thread::yield();
      ASSERT_EQ(publisher->publish(String()).code, agnocast::Errc::ok);
      const auto lost_at = Clock::now() + 60s;
      while (heard < number) {
        ASSERT_LT(Clock::now(), lost_at) << "message " << number;
        std::this_thread::yield();
      }
      if (random() % 50 == 0) mover.cancel();
      if (random() % 1'000 == 0 && kill_daemon()) ++daemons;
    }
    std::cout << heard << " messages, " << mover.spins() << " spins, " << daemons
              << " daemons killed\n";
    EXPECT_GT(mover.spins(), wanted_wakeups() / 200);
    EXPECT_GE(daemons, wanted_wakeups() / 5'000);
  }
  EXPECT_EQ(doubled, 0u);
  EXPECT_EQ(skipped, 0u);
  EXPECT_EQ(heard, wanted_wakeups());
}

// After remove_node() and add_node(), Humble's static executor serves no subscription, rclcpp's
// own neither.
INSTANTIATE_TEST_SUITE_P(Executors, WakeupsTest,
                         testing::Values(&single_threaded, &multi_threaded(2), &multi_threaded(8)),
                         [](const auto& info) { return std::string(info.param->name); });

/// Returns the processor time of this process, in seconds.
double processor_seconds() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
         static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec) / 1e6;
}

TEST_F(RclcppTest, AnIdleNodeSleeps) {
  constexpr auto while_idle = 3s;
  const auto idle_seconds = [&](bool uses_agnocast) {
    const auto node = std::make_shared<rclcpp::Node>("idle");
    const auto theirs = node->create_subscription<String>("theirs", 10, [](const String&) {});
    std::shared_ptr<void> ours;
    if (uses_agnocast)
      ours = agnocast::create_subscription<String>(node, "ours", 10, [](const String&) {});
    rclcpp::executors::SingleThreadedExecutor executor;
    executor.add_node(node);
    SpinningThread spinning(executor);
    std::this_thread::sleep_for(500ms);  // what creation causes
    const double before = processor_seconds();
    std::this_thread::sleep_for(while_idle);
    return processor_seconds() - before;
  };
  const double without = idle_seconds(false), with = idle_seconds(true);
  std::cout << "processor time of " << while_idle.count() << " idle seconds: " << without
            << " s with rclcpp alone, " << with << " s with a subscription of agnocast\n";
  // A loop that does not sleep takes all of them.
  EXPECT_LT(with, without + std::chrono::duration<double>(while_idle).count() / 100);
}

}  // namespace
}  // namespace agnocast_rclcpp
