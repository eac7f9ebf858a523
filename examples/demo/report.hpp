// SPDX-License-Identifier: Apache-2.0
//
// Output of the demo: sizes and times with units, the table of latencies and its plot, progress
// of long steps. Fits 80 columns; uses characters beyond ASCII only if the locale has them.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

namespace demo {

/// printf into a string, 255 characters at most.
__attribute__((format(printf, 1, 2))) std::string format(const char* form, ...);
std::string size_text(std::uint64_t bytes);

/// Medians over the rounds of one size. Zero: not measured.
struct Latency {
  std::uint64_t bytes = 0;
  double agnocast_p50_ns = 0, agnocast_p99_ns = 0;
  double dds_p50_ns = 0, dds_p99_ns = 0;
  double ratio = 0;  // of the medians, dds / agnocast, round by round
  std::uint64_t agnocast_count = 0, dds_count = 0;
};

class Report {
 public:
  Report();
  void line(const std::string& text = {});
  void heading(int number, const std::string& text);
  /// Shows progress: on a terminal in one line that is rewritten, else as a line now and then.
  void progress(double done, const std::string& what);
  void progress_ends();
  void table(const std::vector<Latency>& latencies);
  void plot(const std::vector<Latency>& latencies);
  /// Formats a time, with the locale's micro sign.
  std::string time_text(double nanoseconds) const;

 private:
  const char* micro() const;
  std::string bar(std::size_t length, bool filled) const;
  bool utf8_;
  bool terminal_;
  bool progress_shown_ = false;
  std::chrono::steady_clock::time_point last_progress_ = std::chrono::steady_clock::now();
};

}  // namespace demo
