// SPDX-License-Identifier: Apache-2.0
//
// Figures: what recovery_bench has measured, as a table while it runs and as JSON in the end.
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <deque>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::bench {

using Clock = std::chrono::steady_clock;

inline std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch())
      .count();
}

/// Durations of one kind.
struct Series {
  std::string what;
  std::vector<std::int64_t> ns;

  /// The smallest that `part` of them do not exceed.
  std::int64_t at(double part) const {
    if (ns.empty()) return 0;
    std::vector<std::int64_t> sorted = ns;
    std::sort(sorted.begin(), sorted.end());
    const auto rank =
        static_cast<std::size_t>(std::ceil(part * static_cast<double>(sorted.size())));
    return sorted[std::max<std::size_t>(rank, 1) - 1];
  }
};

class Figures {
 public:
  static void print_head() {
    std::printf("%-66s %8s %9s %9s %9s\n", "milliseconds", "samples", "p50", "p99", "max");
  }
  void add(Series series) {
    const auto ms = [](std::int64_t ns) { return static_cast<double>(ns) / 1e6; };
    std::printf("%-66s %8zu %9.2f %9.2f %9.2f\n", series.what.c_str(), series.ns.size(),
                ms(series.at(0.5)), ms(series.at(0.99)), ms(series.at(1)));
    std::fflush(stdout);
    all_.push_back(std::move(series));
  }
  void add_number(const std::string& what, double value) {
    std::printf("%-66s %8.2f\n", what.c_str(), value);
    std::fflush(stdout);
    numbers_.emplace_back(what, value);
  }
  /// False if the file cannot be written.
  bool write(const std::string& path) const {
    std::ofstream file(path);
    file << "{\"series\": [";
    const char* comma = "\n";
    for (const Series& series : all_) {
      file << comma << R"({"what": ")" << series.what << R"(", "samples": )" << series.ns.size()
           << R"(, "p50_ns": )" << series.at(0.5) << R"(, "p99_ns": )" << series.at(0.99)
           << R"(, "max_ns": )" << series.at(1) << '}';
      comma = ",\n";
    }
    file << "],\n\"numbers\": [";
    comma = "\n";
    for (const auto& [what, value] : numbers_) {
      file << comma << R"({"what": ")" << what << R"(", "value": )" << value << '}';
      comma = ",\n";
    }
    file << "]}\n";
    return static_cast<bool>(file.flush());
  }

 private:
  std::deque<Series> all_;
  std::vector<std::pair<std::string, double>> numbers_;
};

}  // namespace agnocast::bench
