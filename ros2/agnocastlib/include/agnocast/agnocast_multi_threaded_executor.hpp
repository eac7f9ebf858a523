// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/agnocast_executor.hpp>
#include <agnocast_rclcpp/repaired_executor.hpp>

#include <rclcpp/executors/multi_threaded_executor.hpp>

#include <chrono>
#include <cstddef>

namespace agnocast {

/// rclcpp's: every thread runs callbacks of both kinds, and a mutually exclusive group may have
/// both.
class MultiThreadedAgnocastExecutor
    : public agnocast_rclcpp::RepairedExecutor<rclcpp::executors::MultiThreadedExecutor> {
 public:
  /// It has as many threads as both numbers together; 0 stands for half of the processors, at
  /// least one. `agnocast_next_exec_timeout_ms` has no effect: nothing is polled.
  explicit MultiThreadedAgnocastExecutor(
      const rclcpp::ExecutorOptions& options = rclcpp::ExecutorOptions(),
      std::size_t number_of_ros2_threads = 0, std::size_t number_of_agnocast_threads = 0,
      bool yield_before_execute = false,
      std::chrono::nanoseconds ros2_next_exec_timeout = std::chrono::nanoseconds(-1),
      int agnocast_next_exec_timeout_ms = 50);
};

}  // namespace agnocast
