// SPDX-License-Identifier: Apache-2.0
//
// Shared by the tests: rclcpp's life, every executor of rclcpp's, and a thread that spins one.
#pragma once

#include <agnocast_rclcpp/agnocast_rclcpp.hpp>

#include <rclcpp/rclcpp.hpp>
#include <std_msgs/msg/string.hpp>

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>

namespace agnocast_rclcpp {

using String = std_msgs::msg::String;

class RclcppTest : public testing::Test {
 protected:
  void SetUp() override { rclcpp::init(0, nullptr); }
  void TearDown() override { (void)rclcpp::shutdown(); }
};

/// How to make an executor, by name.
struct ExecutorKind {
  const char* name;
  std::function<std::unique_ptr<rclcpp::Executor>(const rclcpp::ExecutorOptions&)> make_with;
  std::unique_ptr<rclcpp::Executor> make() const { return make_with(rclcpp::ExecutorOptions()); }
};
inline const ExecutorKind& multi_threaded(std::size_t threads) {
  static const auto of = [](const char* name, std::size_t count) {
    return ExecutorKind{name, [count](const rclcpp::ExecutorOptions& options) {
                          return std::make_unique<rclcpp::executors::MultiThreadedExecutor>(options,
                                                                                            count);
                        }};
  };
  static const ExecutorKind two = of("multi_2", 2), four = of("multi_4", 4),
                            eight = of("multi_8", 8);
  return threads == 2 ? two : threads == 4 ? four : eight;
}
inline const ExecutorKind single_threaded{
    "single", [](const rclcpp::ExecutorOptions& options) {
      return std::make_unique<rclcpp::executors::SingleThreadedExecutor>(options);
    }};
inline const ExecutorKind static_single_threaded{
    "static_single", [](const rclcpp::ExecutorOptions& options) {
      return std::make_unique<rclcpp::executors::StaticSingleThreadedExecutor>(options);
    }};

/// A test for each of three executors of rclcpp's, which executor_ is. In the same file:
///   AGNOCAST_TEST_EXECUTORS(Test);
class EveryExecutorTest : public RclcppTest,
                          public testing::WithParamInterface<const ExecutorKind*> {
 protected:
  void SetUp() override {
    RclcppTest::SetUp();
    executor_ = GetParam()->make();
  }
  void TearDown() override {
    executor_.reset();
    RclcppTest::TearDown();
  }
  std::unique_ptr<rclcpp::Executor> executor_;
};
#define AGNOCAST_TEST_EXECUTORS(Test)                                                 \
  INSTANTIATE_TEST_SUITE_P(                                                           \
      Executors, Test,                                                                \
      testing::Values(&single_threaded, &static_single_threaded, &multi_threaded(4)), \
      [](const auto& info) { return std::string(info.param->name); })

class SpinningThread {
 public:
  explicit SpinningThread(rclcpp::Executor& executor)
      : executor_(executor), thread_([this] { executor_.spin(); }) {}
  ~SpinningThread() {
    executor_.cancel();
    thread_.join();
  }

 private:
  rclcpp::Executor& executor_;
  std::thread thread_;
};

template <class Condition>
[[nodiscard]] bool eventually(Condition condition) {
  for (int i = 0; i < 30'000; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return false;
}

class Source {
 public:
  explicit Source(const std::string& topic = "topic")
      : node_(std::make_shared<rclcpp::Node>("source_of_" + topic)),
        publisher_(agnocast::create_publisher<String>(node_, topic, rclcpp::QoS(1000))) {}
  /// Publishes when so many listen.
  void publish(int count = 1, std::size_t listeners = 1) {
    ASSERT_TRUE(eventually([&] { return publisher_->get_subscription_count() >= listeners; }));
    publish_to_any(count);
  }
  void publish_to_any(int count = 1) {
    for (int i = 0; i < count; ++i)
      ASSERT_EQ(publisher_->publish(String()).code, agnocast::Errc::ok);
  }

 private:
  rclcpp::Node::SharedPtr node_;
  agnocast::Publisher<String>::SharedPtr publisher_;
};

}  // namespace agnocast_rclcpp
