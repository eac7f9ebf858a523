// SPDX-License-Identifier: Apache-2.0
//
// Goal: an executor that builds no wait set, but is notified by each source that it is ready,
// serves each message once and sleeps otherwise. Method: a small one, because Humble has none; it
// does what rclcpp's events executor does with a waitable.

#include "test_node.hpp"

#include <rclcpp/version.h>

#include <condition_variable>
#include <deque>
#include <mutex>
#include <vector>

namespace agnocast_rclcpp {
namespace {

using namespace std::chrono_literals;
using Message = agnocast::ipc_shared_ptr<const String>;

class EventsExecutor {
 public:
  explicit EventsExecutor(rclcpp::Node& node) {
    node.for_each_callback_group([&](const rclcpp::CallbackGroup::SharedPtr& group) {
      (void)group->find_waitable_ptrs_if([&](const rclcpp::Waitable::SharedPtr& waitable) {
        add(waitable);
        return false;
      });
    });
    thread_ = std::thread([this] { run(); });
  }
  ~EventsExecutor() {
    for (const auto& waitable : waitables_) waitable->clear_on_ready_callback();
    {
      const std::lock_guard lock(mutex_);
      is_over_ = true;
    }
    changed_.notify_one();
    thread_.join();
  }
  std::size_t event_count() {
    const std::lock_guard lock(mutex_);
    return event_count_;
  }

 private:
  void add(const rclcpp::Waitable::SharedPtr& waitable) {
    waitables_.push_back(waitable);
    waitable->set_on_ready_callback([this, waitable](std::size_t count, int) {
      {
        const std::lock_guard lock(mutex_);
        events_.insert(events_.end(), count, waitable);
        event_count_ += count;
      }
      changed_.notify_one();
    });
  }
  void run() {
    for (;;) {
      rclcpp::Waitable::SharedPtr waitable;
      {
        std::unique_lock lock(mutex_);
        changed_.wait(lock, [&] { return is_over_ || !events_.empty(); });
        if (is_over_) return;
        waitable = events_.front();
        events_.pop_front();
      }
#if RCLCPP_VERSION_MAJOR < 28
      std::shared_ptr<void> data = waitable->take_data();
#else
      const std::shared_ptr<void> data = waitable->take_data();
#endif
      waitable->execute(data);
    }
  }

  std::vector<rclcpp::Waitable::SharedPtr> waitables_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<rclcpp::Waitable::SharedPtr> events_;
  std::size_t event_count_ = 0;
  bool is_over_ = false;
  std::thread thread_;
};

class EventsTest : public RclcppTest {};

TEST_F(EventsTest, EachMessageIsServedOnceAndTheExecutorSleepsOtherwise) {
  Source first("first"), second("second");
  const auto node = std::make_shared<rclcpp::Node>("node");
  std::atomic<int> heard{0}, inside{0}, overlapped{0};
  const auto callback = [&](const Message&) {
    if (++inside > 1) ++overlapped;
    ++heard;
    --inside;
  };
  const auto one = agnocast::create_subscription<String>(node, "first", 1000, callback);
  const auto two = agnocast::create_subscription<String>(node, "second", 1000, callback);
  first.publish(100);  // before somebody listens to events
  EventsExecutor executor(*node);
  for (int i = 0; i < 50; ++i) {
    first.publish(10);
    second.publish(10);
    if (i % 10 == 0) std::this_thread::sleep_for(1ms);
  }
  EXPECT_TRUE(eventually([&] { return heard == 1100; })) << heard << " of 1100";
  bool sleeps = false;
  for (int i = 0; i < 50 && !sleeps; ++i) {
    const std::size_t events = executor.event_count();
    std::this_thread::sleep_for(100ms);
    sleeps = executor.event_count() == events;
  }
  EXPECT_TRUE(sleeps) << "it is notified again and again";
  EXPECT_EQ(heard, 1100);
  EXPECT_EQ(overlapped, 0);
  second.publish(1);
  EXPECT_TRUE(eventually([&] { return heard == 1101; })) << "a sleeping executor is not told";
}

TEST_F(EventsTest, NobodyIsToldAfterTheCallbackWasCleared) {
  Source source;
  const auto node = std::make_shared<rclcpp::Node>("node");
  std::atomic<int> heard{0};
  const auto subscription =
      agnocast::create_subscription<String>(node, "topic", 1000, [&](const Message&) { ++heard; });
  {
    EventsExecutor executor(*node);
    source.publish(10);
    EXPECT_TRUE(eventually([&] { return heard == 10; }));
  }
  source.publish(10);
  std::this_thread::sleep_for(50ms);
  EXPECT_EQ(heard, 10);
  // What waited is served by the next executor, of whatever kind.
  rclcpp::executors::SingleThreadedExecutor next;
  next.add_node(node);
  const SpinningThread spinning(next);
  EXPECT_TRUE(eventually([&] { return heard == 20; }));
}

}  // namespace
}  // namespace agnocast_rclcpp
