// SPDX-License-Identifier: Apache-2.0
//
// Refusals: what could not be made for the newest plan, and why. Each reason is logged once, until
// it changes. One thread, run()'s.
#pragma once

#include <bridge/common/log.hpp>

#include <map>
#include <string>
#include <utility>

namespace agnocast::bridge {

class Refusals {
 public:
  /// `log` must outlive it.
  explicit Refusals(const Log& log) : log_(log) {}

  /// Starts a plan: anything not noted again has been made, or is no longer planned.
  void begin_plan() { former_ = std::exchange(now_, {}); }
  /// Notes that something could not be made.
  void note(const std::string& what, const std::string& why) {
    const auto before = former_.find(what);
    const bool is_said = before != former_.end() && before->second == why;
    if (std::exchange(now_[what], why) == why || is_said) return;
    log_.write(LogLevel::warning, "not bridged", {{"what", what}, {"why", why}});
  }
  /// Returns the reasons, by what could not be made.
  const std::map<std::string, std::string>& now() const noexcept { return now_; }

 private:
  const Log& log_;
  std::map<std::string, std::string> now_, former_;  // of this plan, of the previous one
};

}  // namespace agnocast::bridge
