// SPDX-License-Identifier: Apache-2.0
//
// Refusals: what could not be made for the newest plan, and why. The log has each once, until it changes. One thread,
// run()'s.
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

  /// What is not noted again is made, or not planned any longer.
  void begin_plan() { former_ = std::exchange(now_, {}); }
  /// Something could not be made.
  void note(const std::string& what, const std::string& why) {
    const auto before = former_.find(what);
    const bool is_said = before != former_.end() && before->second == why;
    if (std::exchange(now_[what], why) == why || is_said) return;
    log_.write(LogLevel::warning, "not bridged", {{"what", what}, {"why", why}});
  }
  /// By what could not be made.
  const std::map<std::string, std::string>& now() const noexcept { return now_; }

 private:
  const Log& log_;
  std::map<std::string, std::string> now_, former_;  // of this plan, of the one before
};

}  // namespace agnocast::bridge
