// SPDX-License-Identifier: Apache-2.0
//
// bridge: the cost of a message through agnocast-bridge, beside the same message sent natively
// through Cyclone DDS. One run, alternating message by message, so that a disturbance meets all:
//
//   native   sender ── dds_write ───────────────────────────────────────▶ dds_take ── receiver
//   out      sender ── agnocast publish ──▶ agnocast-bridge ──▶ DDS ────▶ dds_take ── receiver
//   in       sender ── dds_write ──▶ DDS ──▶ agnocast-bridge ──▶ agnocast callback ── receiver
//
// PointCloud2, reliable, keep-last 1; sender and receiver are the same two processes for all ways
// (bridge_ends.cpp), and the native ones use idlc's type. Time is from before the sender's call
// until the receiver has the whole message; its content is checked after that. The ratio of a
// size is the median over rounds of median / median. Beside it, the processor time of the bridge
// per message (a process clock, so Cyclone's threads count): until the receiver has it, and from
// then until the next one, such as for releasing the message. Everything is measured once with
// Cyclone DDS's default packet size, and once with large packets, a common configuration for
// large messages. The receive buffer is large in both.
//
// Asserts no time: it fails only if a message was changed or does not arrive.

#include <bench/case.hpp>
#include <bench/cases/looking.hpp>
#include <bench/figures.hpp>
#include <bench/process.hpp>
#include <bench/services.hpp>

#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <map>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::bench {
namespace {

constexpr std::array<const char*, 3> roads{"native", "out", "in"};
const std::vector<std::size_t> default_sizes{1'000, 10'000, 100'000, 1'000'000, 8'000'000};
constexpr std::chrono::milliseconds patience{10'000};
constexpr std::chrono::milliseconds between_attempts{50};
// So that threads have gone to sleep before the next message, as at a sensor's rate.
constexpr std::chrono::milliseconds between_messages{3};

// On the loopback interface, without multicast, separate from every other DDS on this host, and
// with a large receive buffer; otherwise the defaults.
constexpr const char* dds_configuration = R"(<CycloneDDS><Domain id="any">
  <General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>PACKETS</General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>20</MaxAutoParticipantIndex>
    <Tag>TAG</Tag><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
  <Internal><SocketReceiveBufferSize max="16MiB"/></Internal>
</Domain></CycloneDDS>)";
constexpr const char* large_packets =
    "<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize>";

/// Sender, bridge and receiver of one configuration of Cyclone DDS.
class Roads {
 public:
  explicit Roads(bool is_large_packets)
      : uri_(make_uri(is_large_packets)),
        bridge_({.command = {path_of("agnocast-bridge")},
                 .environment = variables(),
                 .output = daemon_.log_path()}),
        receiver_(
            {.command = as_role("bridge-receiver"), .environment = variables(), .has_pipes = true}),
        sender_(
            {.command = as_role("bridge-sender"), .environment = variables(), .has_pipes = true}) {}

  /// Returns nanoseconds for that way; nothing if the message does not arrive within `wait`.
  std::optional<double> send(const char* road, std::size_t bytes, std::chrono::milliseconds wait) {
    const std::uint64_t number = ++number_;
    if (!sender_.send(std::string(road) + ' ' + std::to_string(bytes) + ' ' +
                      std::to_string(number)))
      throw std::runtime_error("the sender has ended");
    const std::string began = sender_.line();
    std::int64_t began_ns = 0;
    if (std::from_chars(began.data(), began.data() + began.size(), began_ns).ec != std::errc())
      throw std::runtime_error(std::string(road) + ": the sender reports: " + began);
    // The receiver answers when it has the message, or "late" when the time is up.
    if (!receiver_.send(std::string(road) + ' ' + std::to_string(number) + ' ' +
                        std::to_string(wait.count())))
      throw std::runtime_error("the receiver has ended");
    const std::string answer = receiver_.line();
    if (answer == "late") return std::nullopt;
    std::int64_t came_ns = 0;
    if (std::from_chars(answer.data(), answer.data() + answer.size(), came_ns).ec != std::errc())
      throw std::runtime_error("the receiver reports: " + answer);
    return static_cast<double>(came_ns - began_ns);
  }

  void warm_up(const std::vector<std::size_t>& sizes) {
    for (const char* const road : roads) {
      const auto end = std::chrono::steady_clock::now() + patience;
      while (!send(road, sizes.front(), between_attempts)) {
        if (std::chrono::steady_clock::now() > end)
          throw std::runtime_error(std::string("nothing comes on the road ") + road +
                                   "; daemon and bridge wrote:\n" + daemon_.log());
      }
      for (const std::size_t size : sizes) {
        for (int i = 0; i < 3; ++i) (void)send(road, size, patience);
      }
    }
  }

  /// Results of one size and round, by way.
  struct Turn {
    std::map<std::string, std::vector<double>> ns;
    // Processor time per message: until it has arrived, and from then until the next one.
    std::map<std::string, double> bridge_ns, bridge_after_ns;
  };
  Turn turn(std::size_t size, std::size_t messages) {
    Turn turn;
    std::this_thread::sleep_for(between_messages);
    for (std::size_t i = 0; i < messages; ++i) {
      for (std::size_t j = 0; j < roads.size(); ++j) {
        const char* const road = roads[(i + j) % roads.size()];
        const double before = cpu_ns_of(bridge_.pid());
        const auto ns = send(road, size, patience);
        const double end = cpu_ns_of(bridge_.pid());
        if (!ns)
          throw std::runtime_error(std::string("a message did not come on the road ") + road);
        std::this_thread::sleep_for(between_messages);
        turn.ns[road].push_back(*ns);
        turn.bridge_ns[road] += (end - before) / static_cast<double>(messages);
        turn.bridge_after_ns[road] +=
            (cpu_ns_of(bridge_.pid()) - end) / static_cast<double>(messages);
      }
    }
    return turn;
  }

 private:
  std::vector<std::string> variables() const {
    auto all = variables_of(daemon_);
    all.push_back("CYCLONEDDS_URI=" + uri_);
    all.push_back("ROS_DOMAIN_ID=0");
    return all;
  }
  static std::string make_uri(bool is_large_packets) {
    static int made = 0;
    std::string text = dds_configuration;
    text.replace(text.find("PACKETS"), 7, is_large_packets ? large_packets : "");
    text.replace(text.find("TAG"), 3,
                 "bridge-bench-" + std::to_string(::getpid()) + "-" + std::to_string(++made));
    return text;
  }

  const std::string uri_;
  Daemon daemon_{
      "[daemon]\nsocket_mode = \"0666\"\n"
      "[heap]\nwindow_bytes = \"1GiB\"\narena_bytes = \"256GiB\"\n"};
  Process bridge_, receiver_, sender_;
  std::uint64_t number_ = 0;
};

class Bridge {
 public:
  Bridge(const Run& run, Report& report)
      : report_(report),
        rounds_(run.rounds.value_or(run.is_small ? 1 : 7)),
        messages_(run.messages.value_or(run.is_small ? 2 : 20)),
        sizes_(run.sizes.empty() ? default_sizes : run.sizes) {}

  void measure(bool is_large_packets) {
    const std::string how = is_large_packets ? "large packets" : "packets by default";
    report_.progress(step_, 2 * sizes_.size(), how);
    Roads roads_here(is_large_packets);
    roads_here.warm_up(sizes_);
    report_.say(text("microseconds, median of %zu rounds of %zu messages; %s", rounds_, messages_,
                     how.c_str()));
    report_.say(text("%10s %10s %10s %10s %11s %11s %16s %16s %16s", "bytes", "native", "out", "in",
                     "out/native", "in/native", "bridge, out", "bridge, in", "CV"));
    for (const std::size_t size : sizes_) {
      report_.progress(step_, 2 * sizes_.size(), how + ", " + std::to_string(size) + " bytes");
      measure(roads_here, size, is_large_packets);
      ++step_;
    }
    report_.progress(step_, 2 * sizes_.size(), how);
  }

 private:
  void measure(Roads& roads_here, std::size_t size, bool is_large_packets) {
    std::map<std::string, std::vector<double>> all, medians, ratio, cpu, cpu_after;
    for (std::size_t round = 0; round < rounds_; ++round) {
      const Roads::Turn turn = roads_here.turn(size, messages_);
      for (const char* const road : roads) {
        const std::vector<double>& ns = turn.ns.at(road);
        all[road].insert(all[road].end(), ns.begin(), ns.end());
        medians[road].push_back(median(ns));
        ratio[road].push_back(median(ns) / median(turn.ns.at("native")));
        cpu[road].push_back(turn.bridge_ns.at(road));
        cpu_after[road].push_back(turn.bridge_after_ns.at(road));
      }
    }
    const auto cpu_text = [&](const char* road) {
      return text("%.0f + %.0f", median(cpu[road]) / 1e3, median(cpu_after[road]) / 1e3);
    };
    report_.say(text("%10zu %10.0f %10.0f %10.0f %11.2f %11.2f %16s %16s %16s", size,
                     median(medians["native"]) / 1e3, median(medians["out"]) / 1e3,
                     median(medians["in"]) / 1e3, median(ratio["out"]), median(ratio["in"]),
                     cpu_text("out").c_str(), cpu_text("in").c_str(),
                     text("%.2f %.2f %.2f", variation(all["native"]), variation(all["out"]),
                          variation(all["in"]))
                         .c_str()));
    Plot plot{.name = text("bridge-%zu%s", size, is_large_packets ? "-large-packets" : ""),
              .kind = "violins",
              .title = text("PointCloud2 of %zu bytes%s", size,
                            is_large_packets ? ", large packets" : ""),
              .x_label = "",
              .y_label = "µs",
              .log_y = true};
    for (const char* const road : roads) {
      report_.add(nlohmann::json{
          {"system", road == std::string("native") ? "cyclonedds" : "agnocast-bridge"},
          {"part", road},
          {"size_bytes", size},
          {"large_packets", is_large_packets},
          {"rounds", rounds_},
          {"samples", all[road].size()},
          {"min_ns", quantile(all[road], 0)},
          {"p50_ns", median(medians[road])},
          {"p99_ns", quantile(all[road], 0.99)},
          {"max_ns", quantile(all[road], 1)},
          {"variation", variation(all[road])},
          {"ratio_to_native", median(ratio[road])},
          {"bridge_cpu_ns", median(cpu[road])},
          {"bridge_cpu_after_ns", median(cpu_after[road])}});
      nlohmann::json values = nlohmann::json::array();
      for (const double ns : all[road]) values.push_back(ns / 1e3);
      plot.series.push_back({{"label", road}, {"values", std::move(values)}});
    }
    report_.add(std::move(plot));
  }

  Report& report_;
  const std::size_t rounds_, messages_;
  const std::vector<std::size_t> sizes_;
  std::size_t step_ = 0;
};

}  // namespace

void run_bridge(const Run& run, Report& report) {
  Bridge bridge(run, report);
  bridge.measure(false);
  bridge.measure(true);
}

}  // namespace agnocast::bench
