// SPDX-License-Identifier: Apache-2.0
//
// Case pipeline: Autoware's LiDAR preprocessing, with Cyclone DDS or agnocast on its one edge
// between processes. pipeline/run.hpp runs it, this file evaluates its times; see
// docs/performance.md.

#include <bench/case.hpp>
#include <bench/figures.hpp>
#include <bench/pipeline/edge.hpp>
#include <bench/pipeline/run.hpp>

#include <algorithm>
#include <array>
#include <cstdio>
#include <numeric>
#include <stdexcept>

namespace agnocast::bench {
namespace {

using pipeline::FrameTimes;
using pipeline::Measured;
using pipeline::Settings;

// Statistics of response times. The bootstrap of a maximum has little meaning: its upper end is
// the maximum itself.
using Statistic = double (*)(const std::vector<double>&);
struct NamedStatistic {
  const char* name;
  Statistic of;
};
constexpr std::array<NamedStatistic, 3> statistics{{
    {"mean", [](const std::vector<double>& samples) { return mean(samples); }},
    {"p99", [](const std::vector<double>& samples) { return quantile(samples, 0.99); }},
    {"max",
     [](const std::vector<double>& samples) {
       return *std::max_element(samples.begin(), samples.end());
     }},
}};

// Figures of the paper for Autoware 2024.07 (mean 64.5 to 54.5 ms, maximum 99.5 to 74.3 ms),
// printed beside ours.
constexpr double paper_change_mean = -0.16, paper_change_max = -0.25;

struct PartOfTime {
  const char* name;
  double FrameTimes::*time;
};
constexpr std::array<PartOfTime, 3> parts{{{"compute", &FrameTimes::compute},
                                           {"transfer", &FrameTimes::transfer},
                                           {"wait", &FrameTimes::wait}}};

std::vector<double> values_of(const std::vector<FrameTimes>& times, double FrameTimes::*time) {
  std::vector<double> values;
  for (const FrameTimes& one : times) values.push_back(one.*time);
  return values;
}

struct Estimate {
  double value = 0;
  Interval interval;
};
Estimate estimate(const std::vector<double>& samples, Statistic of) {
  return {of(samples), bootstrap(samples, of)};
}
/// Returns the relative difference of the second's statistic. Frames are paired by round, so it
/// draws pairs.
Estimate change(const std::vector<double>& first, const std::vector<double>& second, Statistic of) {
  const auto change_of = [&](const std::vector<double>& pairs) {
    std::vector<double> a, b;
    for (const double pair : pairs) {
      a.push_back(first[static_cast<std::size_t>(pair)]);
      b.push_back(second[static_cast<std::size_t>(pair)]);
    }
    return of(b) / of(a) - 1;
  };
  std::vector<double> pairs(first.size());
  std::iota(pairs.begin(), pairs.end(), 0.0);
  return {change_of(pairs), bootstrap(pairs, change_of)};
}

std::string padded(const std::string& text, std::size_t width) {
  return std::string(width - std::min(width, text.size()), ' ') + text;
}
std::string ms_text(double ns) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f", ns * 1e-6);
  return text;
}
std::string percent_text(double part) {
  char text[32];
  std::snprintf(text, sizeof text, "%+.1f %%", part * 100);
  return text;
}
template <class Text>
std::string text_of(const Estimate& of, Text text) {
  return text(of.value) + " [" + text(of.interval.low) + ", " + text(of.interval.high) + "]";
}

std::vector<std::uint32_t> chosen_edges(const Run& run) {
  std::vector<std::uint32_t> chosen;
  for (std::uint32_t i = 0; i < pipeline::edges().size(); ++i) {
    const std::string name(pipeline::edges()[i].name);
    if (run.systems.empty() ||
        std::find(run.systems.begin(), run.systems.end(), name) != run.systems.end())
      chosen.push_back(i);
  }
  if (chosen.empty())
    throw std::runtime_error(
        "it has cyclonedds-tuned and agnocast-executor; name one of them, or both");
  return chosen;
}

Settings settings_of(const Run& run) {
  Settings settings;
  settings.edges = chosen_edges(run);
  settings.scan = run.scan;
  if (run.is_small) settings.rounds = 10, settings.warm_up = 2, settings.inputs = 2;
  if (run.messages) settings.rounds = *run.messages;
  if (run.period) settings.period = *run.period;
  if (settings.period.count() <= 0)
    throw std::runtime_error("its --period is the sensors' and has to be longer than 0");
  return settings;
}

std::string name_of(const Settings& settings, std::size_t place) {
  return std::string(pipeline::edges()[settings.edges[place]].name);
}

void tell_edge(const Settings& settings, const Measured& measured, std::size_t place,
               Report& report) {
  const std::vector<FrameTimes>& times = measured.times[place];
  const std::vector<double> response = values_of(times, &FrameTimes::response);
  const auto period_ns = static_cast<double>(settings.period.count());
  const auto late =
      std::count_if(response.begin(), response.end(), [&](double ns) { return ns > period_ns; });
  nlohmann::json result = {{"part", "response"},
                           {"system", name_of(settings, place)},
                           {"size_bytes", measured.top_bytes},
                           {"points", measured.points},
                           {"period_ns", settings.period.count()},
                           {"samples", response.size()},
                           {"late", late},
                           {"min_ns", quantile(response, 0)},
                           {"p50_ns", median(response)},
                           {"variation", variation(response)}};
  std::string line = padded(name_of(settings, place), 18);
  for (const auto& [name, of] : statistics) {
    const Estimate estimated = estimate(response, of);
    const std::string key = name;
    result[key + "_ns"] = estimated.value;
    result[key + "_low_ns"] = estimated.interval.low;
    result[key + "_high_ns"] = estimated.interval.high;
    line += padded(text_of(estimated, ms_text), 25);
  }
  for (const auto& [name, time] : parts) {
    const double value = mean(values_of(times, time));
    result[std::string(name) + "_mean_ns"] = value;
    line += padded(ms_text(value), 9);
  }
  char spread[32];
  std::snprintf(spread, sizeof spread, "%.3f", variation(response));
  report.say(line + padded(spread, 9) + padded(std::to_string(late), 9));
  report.add(result);
}

void tell_change(const Settings& settings, const Measured& measured, Report& report) {
  const std::vector<double> before = values_of(measured.times[0], &FrameTimes::response);
  const std::vector<double> after = values_of(measured.times[1], &FrameTimes::response);
  nlohmann::json result = {{"part", "change"},
                           {"system", name_of(settings, 1)},
                           {"against", name_of(settings, 0)},
                           {"samples", before.size()},
                           {"paper_change_mean", paper_change_mean},
                           {"paper_change_max", paper_change_max}};
  report.say("");
  report.say("change from " + name_of(settings, 0) + " to " + name_of(settings, 1) +
             ", with its 95 % interval over pairs of frames");
  for (const auto& [name, of] : statistics) {
    const Estimate changed = change(before, after, of);
    const std::string key = std::string("change_") + name;
    result[key] = changed.value;
    result[key + "_low"] = changed.interval.low;
    result[key + "_high"] = changed.interval.high;
    std::string line = padded(name, 8) + padded(text_of(changed, percent_text), 34);
    if (of == statistics[0].of)
      line += "   the paper, in Autoware: " + percent_text(paper_change_mean);
    if (of == statistics[2].of)
      line += "   the paper, in Autoware: " + percent_text(paper_change_max);
    report.say(line);
  }
  report.add(result);
}

void draw(const Settings& settings, const Measured& measured, Report& report) {
  Plot violins{.name = "pipeline-response",
               .kind = "violins",
               .title = "LiDAR pipeline: response time of the top chain",
               .x_label = "edge between the filters and concatenate",
               .y_label = "ms"};
  Plot bars{.name = "pipeline-breakdown",
            .kind = "bars",
            .title = "LiDAR pipeline: what the mean response time consists of",
            .x_label = "",
            .y_label = "ms"};
  for (const auto& part : parts) bars.groups.emplace_back(part.name);
  for (std::size_t place = 0; place < measured.times.size(); ++place) {
    std::vector<double> response = values_of(measured.times[place], &FrameTimes::response);
    for (double& value : response) value *= 1e-6;
    std::vector<double> means;
    for (const auto& part : parts)
      means.push_back(mean(values_of(measured.times[place], part.time)) * 1e-6);
    violins.series.push_back({{"label", name_of(settings, place)}, {"values", response}});
    bars.series.push_back({{"label", name_of(settings, place)}, {"y", means}});
  }
  report.add(violins);
  report.add(bars);
}

}  // namespace

void run_pipeline(const Run& asked, Report& report) {
  const Settings settings = settings_of(asked);
  const Measured measured = pipeline::run(
      settings, [&](std::size_t done, std::size_t all) { report.progress(done, all, "frames"); });
  char head[160];
  std::snprintf(head, sizeof head,
                "the top chain sends %.2f MB a frame; concatenate puts out %llu points; %zu rounds",
                static_cast<double>(measured.top_bytes) * 1e-6,
                static_cast<unsigned long long>(measured.points), settings.rounds);
  report.say(head);
  report.say(
      "response time of the top chain, ms, with 95 % intervals; its mean's parts, ms; frames that "
      "took "
      "longer than the period");
  report.say(padded("", 18) + padded("mean", 25) + padded("p99", 25) + padded("max", 25) +
             padded("compute", 9) + padded("transfer", 9) + padded("wait", 9) + padded("CV", 9) +
             padded("late", 9));
  for (std::size_t place = 0; place < settings.edges.size(); ++place)
    tell_edge(settings, measured, place, report);
  if (settings.edges.size() == 2)
    tell_change(settings, measured, report);
  else
    report.say("no comparison: one edge alone was asked for, or is in this build");
  draw(settings, measured, report);
}

}  // namespace agnocast::bench
