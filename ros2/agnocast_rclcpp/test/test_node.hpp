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
  std::function<std::unique_ptr<rclcpp::Executor>()> make;
};
inline const ExecutorKind& multi_threaded(std::size_t threads) {
  static const auto of = [](const char* name, std::size_t count) {
    return ExecutorKind{name, [count] {
                          return std::make_unique<rclcpp::executors::MultiThreadedExecutor>(
                              rclcpp::ExecutorOptions(), count);
                        }};
  };
  static const ExecutorKind two = of("multi_2", 2), four = of("multi_4", 4),
                            eight = of("multi_8", 8);
  return threads == 2 ? two : threads == 4 ? four : eight;
}
inline const ExecutorKind single_threaded{
    "single", [] { return std::make_unique<rclcpp::executors::SingleThreadedExecutor>(); }};
inline const ExecutorKind static_single_threaded{
    "static_single",
    [] { return std::make_unique<rclcpp::executors::StaticSingleThreadedExecutor>(); }};

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

}  // namespace agnocast_rclcpp
