// SPDX-License-Identifier: Apache-2.0
//
// LimitsLog: logs how often other participants in DDS exceeded a limit (limits.hpp). One thread,
// run()'s.
#pragma once

#include <bridge/common/log.hpp>
#include <bridge/dds/limits.hpp>

#include <cstdint>
#include <string>

namespace agnocast::bridge {

class LimitsLog {
 public:
  /// Both must outlive it.
  LimitsLog(const Limits& limits, const Log& log) : limits_(limits), log_(log) {}

  /// Logs the refusals if there are more than in the last line and that line is not too recent.
  void write() {
    std::uint64_t all = 0;
    for (const LimitRow& row : limit_table) all += limits_.refused(row.limit);
    if (all == reported_ || !reports_.now()) return;
    reported_ = all;
    std::string text;
    for (const LimitRow& row : limit_table) {
      if (const std::uint64_t refused = limits_.refused(row.limit); refused != 0)
        text += (text.empty() ? "" : ", ") + std::string(row.name) + ' ' + std::to_string(refused);
    }
    log_.write(LogLevel::warning, "limit exceeded", {{"refused", text}});
  }

 private:
  const Limits& limits_;
  const Log& log_;
  std::uint64_t reported_ = 0;  // refusals in the last log line
  Seldom reports_;
};

}  // namespace agnocast::bridge
