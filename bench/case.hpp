// SPDX-License-Identifier: Apache-2.0
//
// A case of agnocast-bench: what it is given, and what it gives back.
//
// A case prints its tables on stdout through Report::say, and hands over results (objects for machines, see
// schemas/bench-1.json) and pictures. It asserts no time. It throws std::runtime_error when something did not work:
// a message lost or changed, a process that ended.
#pragma once

#include <nlohmann/json.hpp>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::bench {

/// What was asked for; what is not said is the case's own default.
struct Run {
  std::optional<std::size_t> rounds = {};
  std::optional<std::size_t> messages = {};  ///< of a round and system
  std::optional<std::chrono::microseconds> period = {};
  std::vector<std::size_t> sizes = {};    ///< bytes
  std::vector<std::string> systems = {};  ///< names; empty: all that fit
  std::string scan = {};                  ///< pipeline: a recorded scan instead of the simulator
  bool is_small = false;                  ///< as short as works, for a test: seconds in all

#ifdef NDEBUG
  bool has_assertions = false;
#else
  bool has_assertions = true;  ///< a build to look for faults, which says nothing of times
#endif

  /// The median of a few rounds is chance.
  bool has_enough_rounds() const { return rounds.value_or(enough_rounds) >= enough_rounds; }
  static constexpr std::size_t enough_rounds = 7;
};

/// A picture, drawn by agnocast-bench-plot from its JSON. One of:
///   violins  series: {"label", "values": […]}           one violin each, with median and p99
///   lines    series: {"label", "x": […], "y": […]}      curves with points
///   bars     series: {"label", "y": […]} and "groups": [names]   bars side by side
/// `log_x`, `log_y` choose logarithmic axes; a table of at most 2,000 values a series is kept.
struct Plot {
  std::string name;  ///< file name without suffix: "latency-1-core"
  std::string kind;  ///< violins, lines, bars
  std::string title, x_label, y_label;
  bool log_x = false, log_y = false;
  std::vector<std::string> groups = {};
  nlohmann::json series = nlohmann::json::array();
};

/// Gathers what cases give. Not thread-safe.
class Report {
 public:
  /// Where progress is told; null: nowhere. By default stderr, where that is a terminal.
  explicit Report(std::FILE* bar = terminal()) noexcept : bar_(bar) {}
  /// A line for people, to stdout (not with --json=-).
  void say(const std::string& line);
  /// One object of "results"; the case's name is added.
  void add(nlohmann::json result);
  void add(Plot plot);
  /// How far the case is: `done` of `all` its steps, with the time left. The first call is with `done` 0.
  void progress(std::size_t done, std::size_t all, std::string_view what);

  /// `usual` is the first guess of the time left; 0: there is none.
  void begin_case(std::string_view name, std::chrono::seconds usual);
  /// Before somebody else writes on the terminal.
  void clear_bar();
  bool is_quiet = false;  ///< say() prints nothing
  nlohmann::json results = nlohmann::json::array();
  nlohmann::json plots = nlohmann::json::array();

 private:
  static std::FILE* terminal() noexcept;

  std::FILE* bar_;
  std::string case_;
  std::chrono::steady_clock::time_point began_{};
  std::chrono::seconds usual_{0};
  bool has_bar_ = false;
};

/// A system as --list has it.
struct SystemName {
  std::string_view name, summary;
};

struct Case {
  std::string_view name;
  std::string_view summary;
  /// What its default run takes here, about.
  std::chrono::seconds usual;
  void (*run)(const Run&, Report&);
  /// Which of the options that not every case has it reads: "--rounds", … What no case reads that was asked for is refused.
  std::set<std::string_view> reads = {};
  /// What --systems may name; null where that is not read.
  std::vector<SystemName> (*systems)() = nullptr;
  std::size_t sizes_max = SIZE_MAX;        ///< so many --sizes at once
  std::vector<std::size_t> sizes_of = {};  ///< these --sizes alone; empty: any
};

// cases/*.cpp
void run_latency(const Run&, Report&);
void run_throughput(const Run&, Report&);
void run_fanout(const Run&, Report&);
void run_load(const Run&, Report&);
void run_alloc(const Run&, Report&);
void run_memory(const Run&, Report&);
void run_scale(const Run&, Report&);
void run_death(const Run&, Report&);
void run_bridge(const Run&, Report&);
void run_pipeline(const Run&, Report&);

}  // namespace agnocast::bench
