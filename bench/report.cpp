// SPDX-License-Identifier: Apache-2.0
//
// Report: what cases say to people goes to stdout line by line, what they say to machines is kept until the end.

#include <bench/case.hpp>

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <random>

namespace agnocast::bench {
namespace {

// As many as a violin needs, drawn at random so that its shape stays; both ends stay too.
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
  if (has_bar_) std::fputs("\r\033[K", stderr);
  has_bar_ = false;
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
  if (::isatty(STDERR_FILENO) == 0) return;
  const auto now = std::chrono::steady_clock::now();
  if (done == 0) began_ = now;  // steps are counted from here, and so is time
  const std::chrono::duration<double> gone = now - began_;
  std::fprintf(stderr, "\r\033[K%s: %zu of %zu, ", case_.c_str(), done, all);
  if (done > 0)
    std::fprintf(stderr, "%.0f s left, ",
                 gone.count() * static_cast<double>(all - done) / static_cast<double>(done));
  std::fprintf(stderr, "%.*s", static_cast<int>(what.size()), what.data());
  has_bar_ = true;
  if (done == all) std::fputs("\r\033[K", stderr), has_bar_ = false;
  std::fflush(stderr);
}

void Report::begin_case(std::string_view name) {
  case_ = name;
  began_ = std::chrono::steady_clock::now();
}

}  // namespace agnocast::bench
