// SPDX-License-Identifier: Apache-2.0
//
// FailureLog: logs the failures of functions that return nothing, because they return nothing in
// the kernel-module system either: at most once a second, with the code, its sentence and its
// remedy.
#pragma once

#include <agnocastlib/core.hpp>
#include <agnocastlib/forked_child.hpp>

#include <rclcpp/logger.hpp>

#include <atomic>
#include <cstdint>
#include <string>
#include <utility>

namespace agnocastlib {

/// One kind of failure of one endpoint. Any thread may call any function.
class FailureLog {
 public:
  /// `what`: what fails, as the beginning of a sentence ("publishing on '/points'").
  FailureLog(rclcpp::Logger logger, std::string what)
      : logger_(std::move(logger)), what_(std::move(what)) {
    (void)is_forked_child();  // its first call is in the process of the endpoint
  }
  /// Writes one line at level error, or counts the failure for the next line if the last one is
  /// less than a second old. In a forked child, it does nothing.
  void report(agnocast::Errc code) noexcept;
  /// The same, with the detail of a failure of this thread.
  void report(const agnocast::Failure& failure) noexcept;

 private:
  bool is_due(std::uint64_t& silent) noexcept;

  const rclcpp::Logger logger_;
  const std::string what_;
  std::atomic<std::int64_t> next_ns_{0};  // steady_clock; before it, nothing is written
  std::atomic<std::uint64_t> silent_{0};  // failures since the last line
};

}  // namespace agnocastlib
