// SPDX-License-Identifier: Apache-2.0
//
// Report: prints text for users to stdout line by line, and keeps results for machines until the
// end. The progress is a line on the terminal that the next output replaces.

#include <bench/case.hpp>

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <random>

namespace agnocast::bench {
namespace {

// Keeps as many values as a violin needs, drawn at random so that its shape stays; also both
// ends.
nlohmann::json thinned(const nlohmann::json& values) {
  constexpr std::size_t kept_max = 2000;
  if (values.size() <= kept_max) return values;
  auto sorted = values.get<std::vector<double>>();
  std::sort(sorted.begin(), sorted.end());
  std::mt19937_64 random(1);
  nlohmann::json kept = {sorted.front(), sorted.back()};
  std::sample(sorted.begin() + 1, sorted.end() - 1, std::back_inserter(kept), kept_max - 2, random);
  return kept;
}

}  // namespace

void Report::say(const std::string& line) {
  clear_bar();
  if (is_quiet) return;
  std::printf("%s\n", line.c_str());
  std::fflush(stdout);
}

void Report::add(nlohmann::json result) {
  result["case"] = case_;
  results.push_back(std::move(result));
}

void Report::add(Plot plot) {
  for (nlohmann::json& series : plot.series) {
    if (series.contains("values")) series["values"] = thinned(series["values"]);
  }
  plots.push_back({{"case", case_},
                   {"name", plot.name},
                   {"kind", plot.kind},
                   {"title", plot.title},
                   {"x_label", plot.x_label},
                   {"y_label", plot.y_label},
                   {"log_x", plot.log_x},
                   {"log_y", plot.log_y},
                   {"groups", plot.groups},
                   {"series", plot.series}});
}

void Report::progress(std::size_t done, std::size_t all, std::string_view what) {
  if (bar_ == nullptr) return;
  const auto now = std::chrono::steady_clock::now();
  if (done == 0) began_ = now;  // steps and time are counted from here
  clear_bar();
  if (done >= all) return;
  const std::chrono::duration<double> gone = now - began_;
  const double left_s =
      done == 0 ? static_cast<double>(usual_.count())
                : gone.count() * static_cast<double>(all - done) / static_cast<double>(done);
  std::fprintf(bar_, "%s: %zu of %zu, ", case_.c_str(), done, all);
  if (done > 0 || usual_.count() > 0) std::fprintf(bar_, "%.0f s left, ", left_s);
  std::fprintf(bar_, "%.*s", static_cast<int>(what.size()), what.data());
  std::fflush(bar_);
  has_bar_ = true;
}

void Report::begin_case(std::string_view name, std::chrono::seconds usual) {
  case_ = name;
  usual_ = usual;
}

void Report::clear_bar() {
  if (!has_bar_) return;
  std::fputs("\r\033[K", bar_);
  std::fflush(bar_);
  has_bar_ = false;
}

std::FILE* Report::terminal() noexcept { return ::isatty(STDERR_FILENO) == 0 ? nullptr : stderr; }

}  // namespace agnocast::bench
