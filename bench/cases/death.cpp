// SPDX-License-Identifier: Apache-2.0
//
// death: the cost of a death for the remaining processes. Real processes, the real daemon and its
// supervisor, SIGKILL. Asserts no time; it fails with a sentence if an event takes more than ten
// seconds or a message is lost. death_peer.cpp is the peer of the dying process and measures,
// death_client.cpp has the dying processes. All durations begin before kill():
//
//   ended      its pidfd is readable: the kernel has released its memory. Until then it is the
//              kernel's time
//   told       the peer's event callback runs: it is unmatched
//   back       the publisher's message that the dead subscriber held is destroyed, its memory
//              free again
//   free       the daemon has released everything: index, addresses, descriptors; the peer has
//              unmapped
//   creation meanwhile   with a large heap: the longest of the creations that the peer requests
//                        until then
//   answered   a creation requested just after the daemon's death is answered
//   all back   every client has rejoined
//
// Beside the daemon's deaths a stream of 1 kHz: alternating seconds with a death and a creation
// every 200 ms, and with the creations alone. --rounds is the number of deaths of each kind of
// client (200); half as many with the large heap, a quarter with idle neighbours and of the
// daemon. --sizes is the mapped and touched size of the large heap (1 GiB).

#include <bench/case.hpp>
#include <bench/cases/looking.hpp>
#include <bench/figures.hpp>
#include <bench/process.hpp>
#include <bench/services.hpp>

#include <cctype>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::bench {
namespace {

// Time limits in death_peer.cpp are for many deaths; at most one happens between two of its
// lines.
constexpr std::chrono::minutes patience{20};
// Number of its "step" lines; the last step is its end.
constexpr std::size_t steps = 9;

class Death {
 public:
  Death(const Run& run, Report& report)
      : report_(report),
        peer_(
            {.command = as_role(
                 "death-peer", {std::to_string(run.rounds.value_or(run.is_small ? 4 : 200)),
                                std::to_string(!run.sizes.empty()
                                                   ? run.sizes.front()
                                                   : std::size_t{run.is_small ? 16u : 1024u} << 20),
                                std::to_string(run.is_small ? 3 : 100)}),
             .environment = {"LD_PRELOAD=" + path_of("libagnocast_heaphook.so"),
                             "TMPDIR=" + directory_.path()},
             .has_pipes = true}) {}

  void run() {
    report_.say(
        text("%-66s %8s %9s %9s %9s %6s", "milliseconds", "samples", "p50", "p99", "max", "CV"));
    for (std::size_t step = 0;;) {
      std::istringstream line(peer_.line(patience));
      std::string word, name;
      line >> word;
      std::getline(line >> std::ws, name);
      if (word == "done") break;
      if (word == "failed") throw std::runtime_error(name);
      if (word == "step") report_.progress(step++, steps, name);
      if (word == "series") add_series(name, values_of(peer_.line(patience)));
      if (word == "number") add_number(name, values_of(peer_.line(patience)).at(0));
    }
    report_.progress(steps, steps, "");
    if (const auto status = peer_.wait(std::chrono::seconds(30)); status != 0)
      throw std::runtime_error(
          "the peer has said all, but " +
          (status ? "ended with status " + std::to_string(*status) : std::string("does not end")));
    for (auto& [name, plot] : plots_) report_.add(std::move(plot));
  }

 private:
  static std::vector<double> values_of(const std::string& line) {
    std::istringstream words(line);
    std::vector<double> values;
    for (double value = 0; words >> value;) values.push_back(value);
    return values;
  }

  void add_series(const std::string& name, const std::vector<double>& ns) {
    const bool has_p99 = ns.size() >= p99_samples_min;
    const std::string p99 = has_p99 ? text("%.2f", quantile(ns, 0.99) / 1e6) : "-";
    report_.say(text("%-66s %8zu %9.2f %9s %9.2f %6.2f", name.c_str(), ns.size(), median(ns) / 1e6,
                     p99.c_str(), quantile(ns, 1) / 1e6, variation(ns)));
    nlohmann::json result{{"system", "agnocast-executor"}, {"part", name},
                          {"samples", ns.size()},          {"min_ns", quantile(ns, 0)},
                          {"p50_ns", median(ns)},          {"max_ns", quantile(ns, 1)},
                          {"variation", variation(ns)}};
    if (has_p99) result["p99_ns"] = quantile(ns, 0.99);
    report_.add(std::move(result));
    nlohmann::json values = nlohmann::json::array();
    for (const double value : ns) values.push_back(value / 1e6);
    plot_of(name).series.push_back({{"label", label_of(name)}, {"values", std::move(values)}});
  }
  /// Returns "ended" for "publisher dies, small heap: ended": a violin in the plot named by the
  /// part before.
  static std::string label_of(const std::string& series) {
    const std::size_t colon = series.rfind(": ");
    const std::string stream = "1 kHz stream, ";
    if (series.starts_with(stream)) return series.substr(stream.size(), colon - stream.size());
    return series.substr(colon + 2) + (series.starts_with("no death") ? ", no death" : "");
  }
  void add_number(const std::string& name, double value) {
    report_.say(text("%-66s %8.2f", name.c_str(), value));
    report_.add(nlohmann::json{{"system", "agnocast-executor"}, {"part", name}, {"value", value}});
  }

  /// One plot for each kind of death; those of the stream and of the daemon include the
  /// comparison without deaths.
  Plot& plot_of(const std::string& series) {
    std::string title = series.substr(0, series.rfind(": "));
    std::string name = "death-";
    if (series.starts_with("1 kHz stream")) {
      title = "1 kHz stream beside deaths of the daemon";
      name += "stream";
    } else {
      if (title.starts_with("no death")) title.replace(0, 8, "daemon dies");
      for (const char letter : title) {
        if (letter == ' ') name += '-';
        if (std::isalnum(static_cast<unsigned char>(letter)) != 0)
          name += static_cast<char>(std::tolower(letter));
      }
    }
    const auto [place, is_new] = plots_.try_emplace(name);
    Plot& plot = place->second;
    if (is_new) {
      plot.name = name;
      plot.kind = "violins";
      plot.title = title;
      plot.y_label = "ms";
      plot.log_y = true;
    }
    return plot;
  }

  Report& report_;
  Directory directory_;  // contains the peer's, which may end without removing them
  Process peer_;
  std::map<std::string, Plot> plots_;
};

}  // namespace

void run_death(const Run& run, Report& report) { Death(run, report).run(); }

}  // namespace agnocast::bench
