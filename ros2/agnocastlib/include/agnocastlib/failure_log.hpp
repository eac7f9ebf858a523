// SPDX-License-Identifier: Apache-2.0
//
// What the functions of this package do not return, because those of the kernel-module system
// return nothing there, is logged: at most once a second, with the code, its sentence and its
// remedy.
#pragma once

#include <agnocastlib/core.hpp>

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
      : logger_(std::move(logger)), what_(std::move(what)) {}
  /// Writes one line at level error, or counts the failure for the next line if the last one is
  /// less than a second old.
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
