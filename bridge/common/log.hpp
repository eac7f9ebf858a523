// SPDX-License-Identifier: Apache-2.0
//
// Log: what the bridge reports to an administrator: events with fields. main() chooses the
// destination.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::bridge {

enum class LogLevel : std::uint8_t { error, warning, notice, info, debug };

/// Any thread.
class Log {
 public:
  using Fields = std::vector<std::pair<std::string_view, std::string>>;
  using Sink = std::function<void(LogLevel, std::string_view event, const Fields& fields)>;

  explicit Log(Sink sink) : sink_(std::move(sink)) {}
  void write(LogLevel level, std::string_view event, const Fields& fields = {}) const {
    sink_(level, event, fields);
  }

 private:
  Sink sink_;
};

/// Limits log lines that others can cause: now() is true at most once in ten seconds. Any thread.
class Seldom {
 public:
  bool now() noexcept {
    const auto time = std::chrono::steady_clock::now().time_since_epoch().count();
    auto silent = silent_until_.load(std::memory_order_relaxed);
    constexpr std::chrono::steady_clock::duration interval = std::chrono::seconds(10);
    return time >= silent && silent_until_.compare_exchange_strong(silent, time + interval.count());
  }

 private:
  std::atomic<std::chrono::steady_clock::rep> silent_until_{0};
};

}  // namespace agnocast::bridge
