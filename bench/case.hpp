// SPDX-License-Identifier: Apache-2.0
//
// A case of agnocast-bench: its input and its output.
//
// A case prints its tables on stdout through Report::say, and adds results (objects for machines,
// see schemas/bench-1.json) and plots. It asserts no time. It throws std::runtime_error on a
// failure: a message lost or changed, a process that ended.
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

inline constexpr std::size_t kib = 1024, mib = 1024 * kib;  ///< bytes

/// The requested run; a case has its own defaults for everything else.
struct Run {
  std::optional<std::size_t> rounds = {};
  std::optional<std::size_t> messages = {};  ///< per round and system
  std::optional<std::chrono::microseconds> period = {};
  std::vector<std::size_t> sizes = {};    ///< bytes
  std::vector<std::string> systems = {};  ///< names; empty: all that the case supports
  std::string scan = {};                  ///< pipeline: a recorded scan instead of the simulator
  bool is_small = false;                  ///< as short as possible, for a test: a few seconds

#ifdef NDEBUG
  bool has_assertions = false;
#else
  bool has_assertions = true;  ///< a debug build, whose times have no meaning
#endif

  /// Returns whether there are enough rounds: the median of a few is chance.
  bool has_enough_rounds() const { return rounds.value_or(enough_rounds) >= enough_rounds; }
  static constexpr std::size_t enough_rounds = 7;
};

/// A plot, drawn by agnocast-bench-plot from its JSON. One of:
///   violins  series: {"label", "values": […]}           one violin each, with median and p99
///   lines    series: {"label", "x": […], "y": […]}      curves with points
///   bars     series: {"label", "y": […]} and "groups": [names]   bars side by side
/// `log_x`, `log_y` choose logarithmic axes; at most 2,000 values per series are kept.
struct Plot {
  std::string name;  ///< file name without suffix: "latency-1-core"
  std::string kind;  ///< violins, lines, bars
  std::string title, x_label, y_label;
  bool log_x = false, log_y = false;
  std::vector<std::string> groups = {};
  nlohmann::json series = nlohmann::json::array();
};

/// Collects the output of cases. Not thread-safe.
class Report {
 public:
  /// `bar`: where progress is shown; null: nowhere. Default: stderr, if that is a terminal.
  explicit Report(std::FILE* bar = terminal()) noexcept : bar_(bar) {}
  /// Prints a line to stdout (not with --json=-).
  void say(const std::string& line);
  /// Adds one object of "results"; adds the case's name to it.
  void add(nlohmann::json result);
  void add(Plot plot);
  /// Shows the progress of the case: `done` of `all` steps, with the time left. The first call
  /// has `done` 0.
  void progress(std::size_t done, std::size_t all, std::string_view what);

  /// `usual` is the first estimate of the time left; 0: unknown.
  void begin_case(std::string_view name, std::chrono::seconds usual);
  /// Call it before other code writes to the terminal.
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

/// A system, as --list prints it.
struct SystemName {
  std::string_view name, summary;
};

struct Case {
  std::string_view name;
  std::string_view summary;
  /// Approximate duration of its default run.
  std::chrono::seconds usual;
  void (*run)(const Run&, Report&);
  /// Its options among those that only some cases read: "--rounds", … Options that no requested
  /// case reads are refused.
  std::set<std::string_view> reads = {};
  /// Systems that --systems may name; null if the case ignores it.
  std::vector<SystemName> (*systems)() = nullptr;
  std::size_t sizes_max = SIZE_MAX;        ///< most --sizes at once
  std::vector<std::size_t> sizes_of = {};  ///< the only --sizes allowed; empty: any
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
void run_ros2(const Run&, Report&);
void run_rmw(const Run&, Report&);

}  // namespace agnocast::bench
