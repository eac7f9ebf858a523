// SPDX-License-Identifier: Apache-2.0
//
// bridge_bench: what a message costs that goes through agnocast-bridge, beside the same message sent natively
// through Cyclone DDS. One run, taking turns message by message, so what disturbs one disturbs all:
//
//   native   sender ── dds_write ───────────────────────────────────────▶ dds_take ── receiver
//   out      sender ── agnocast publish ──▶ agnocast-bridge ──▶ DDS ────▶ dds_take ── receiver
//   in       sender ── dds_write ──▶ DDS ──▶ agnocast-bridge ──▶ agnocast callback ── receiver
//
// PointCloud2, reliable, keep-last 1; sender and receiver are the same two processes on all roads, and the native
// ones use idlc's type. Time is from before the sender's call until the receiver has the whole message in its
// hands; its content is checked after that. The ratio of a size is the median over rounds of median / median.
// Beside it, the processor time of the bridge for each message (a process clock, so Cyclone's threads count).
//
// No time is asserted: status 1 only for a message that was changed or does not come.

#include <bench/recovery_figures.hpp>
#include <examples/demo/content.hpp>
#include <examples/demo/dds_road.hpp>
#include <tests/support/daemon_process.hpp>
#include <tests/support/plain_node.hpp>
#include <tests/support/steered_process.hpp>

#include <agnocast/agnocast.hpp>

#include <nlohmann/json.hpp>

#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

namespace agnocast::bench {
namespace {

using demo::Cloud;
using test::SteeredProcess;

constexpr std::array<const char*, 3> roads{"native", "out", "in"};
constexpr std::array<std::size_t, 5> sizes{1'000, 10'000, 100'000, 1'000'000, 8'000'000};
constexpr std::chrono::milliseconds patience{10'000};
constexpr std::chrono::milliseconds between_attempts{50};
// So that threads have gone to sleep before the next message, as at a sensor's rate.
constexpr std::chrono::milliseconds between_messages{3};

// On the loopback interface, found without multicast, apart from every other DDS here; the rest as by default.
constexpr const char* dds_configuration = R"(<CycloneDDS><Domain id="any">
  <General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>PACKETS</General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>20</MaxAutoParticipantIndex>
    <Tag>TAG</Tag><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
  <Internal><SocketReceiveBufferSize max="16MiB"/></Internal>
</Domain></CycloneDDS>)";
// What many configure for large messages on a fast network: few packets, each as large as UDP has them.
constexpr const char* large_packets =
    "<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize>";

[[noreturn]] void give_up(const std::string& what) {
  std::fprintf(stderr, "bridge_bench: %s\n", what.c_str());
  std::fflush(stdout);
  std::exit(1);
}

// --- the two processes

/// Answers "ROAD BYTES NUMBER" with when it began to send, or with why it could not.
int be_sender() {
  std::string why;
  const auto native = demo::DdsWriter::make("rt/native", why);
  const auto inward = demo::DdsWriter::make("rt/in", why);
  if (native == nullptr || inward == nullptr) give_up(why);
  const auto publisher = create_publisher<Cloud>(test::PlainNode(), "/out", QoS(1).reliable());
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream words(line);
    std::string road;
    std::size_t bytes = 0;
    std::uint64_t number = 0;
    words >> road >> bytes >> number;
    std::int64_t began = 0;
    bool is_sent = false;
    if (road == "out") {
      auto loan = publisher->borrow_loaned_message();
      demo::build(*loan, number, bytes);
      began = now_ns();
      is_sent = static_cast<bool>(publisher->publish(std::move(loan)));
    } else {
      Cloud cloud;
      demo::build(cloud, number, bytes);
      demo::DdsWriter& writer = road == "in" ? *inward : *native;
      writer.fill(cloud);
      began = now_ns();
      is_sent = writer.write();
    }
    std::printf("%s\n", is_sent ? std::to_string(began).c_str() : "not sent");
    std::fflush(stdout);
  }
  return 0;
}

/// Says "ROAD NUMBER TIME INTACT" of whatever comes, until its input ends.
int be_receiver() {
  static std::mutex mutex;
  const auto say = [](const char* road, std::uint64_t number, std::uint64_t time, bool is_intact) {
    const std::lock_guard lock(mutex);
    std::printf("%s %llu %llu %d\n", road, static_cast<unsigned long long>(number),
                static_cast<unsigned long long>(time), is_intact ? 1 : 0);
    std::fflush(stdout);
  };
  std::string why;
  const auto reader_of = [&](const char* road, const std::string& topic) {
    auto reader = demo::DdsReader::make(
        topic,
        [&say, road](std::uint64_t number, bool is_intact, std::uint64_t time) {
          say(road, number, time, is_intact);
        },
        why);
    if (reader == nullptr) give_up(why);
    return reader;
  };
  const auto native = reader_of("native", "rt/native");
  const auto outward = reader_of("out", "rt/out");
  const auto subscription = create_subscription<Cloud>(
      test::PlainNode(), "/in", QoS(1).reliable(), [&say](const ipc_shared_ptr<Cloud>& cloud) {
        const auto time = static_cast<std::uint64_t>(now_ns());
        say("in", demo::number_of(*cloud), time, demo::is_intact<demo::RosAccess>(*cloud));
      });
  for (std::string line; std::getline(std::cin, line);) {
  }
  std::_Exit(0);  // callbacks may still run
}

// --- the conductor

struct Options {
  std::size_t rounds = 7, messages = 20;
  std::size_t largest = sizes.back();
  bool is_large_packets = false;
  std::string json;
};

double cpu_ms_of(pid_t pid) {
  clockid_t clock{};
  timespec time{};
  if (::clock_getcpuclockid(pid, &clock) != 0 || ::clock_gettime(clock, &time) != 0)
    give_up("agnocast-bridge has ended");
  return static_cast<double>(time.tv_sec) * 1e3 + static_cast<double>(time.tv_nsec) / 1e6;
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t middle = values.size() / 2;
  return values.size() % 2 == 1 ? values[middle] : (values[middle - 1] + values[middle]) / 2;
}

class Conductor {
 public:
  Conductor(const Options& options, const std::string& self)
      : options_(options),
        bridge_({AGNOCAST_BRIDGE}, variables()),
        receiver_({self, "--role=receiver"}, variables()),
        sender_({self, "--role=sender"}, variables()) {}

  /// Nanoseconds on that road; nothing if it does not come within `wait`.
  std::optional<std::int64_t> send(const char* road, std::size_t bytes,
                                   std::chrono::milliseconds wait) {
    const std::uint64_t number = ++number_;
    sender_.tell(std::string(road) + ' ' + std::to_string(bytes) + ' ' + std::to_string(number));
    const std::string began = sender_.answer();
    std::int64_t began_ns = 0;
    if (std::from_chars(began.data(), began.data() + began.size(), began_ns).ec != std::errc())
      give_up(std::string(road) + ": the sender says " + began);
    const auto end = std::chrono::steady_clock::now() + wait;
    while (std::chrono::steady_clock::now() < end) {
      if (!receiver_.has_answer(wait)) return std::nullopt;
      std::istringstream words(receiver_.answer());
      std::string from;
      std::uint64_t got = 0;
      std::int64_t time = 0;
      bool is_intact = false;
      words >> from >> got >> time >> is_intact;
      if (!is_intact) give_up("a message was changed, or the receiver says " + words.str());
      if (got == number && from == road) return time - began_ns;
    }
    return std::nullopt;
  }

  void warm_up() {
    for (const char* const road : roads) {
      const auto end = std::chrono::steady_clock::now() + patience;
      while (!send(road, sizes[0], between_attempts)) {
        if (std::chrono::steady_clock::now() > end)
          give_up(std::string("nothing comes on the road ") + road);
      }
      for (const std::size_t size : sizes) {
        for (int i = 0; i < 3 && size <= options_.largest; ++i) (void)send(road, size, patience);
      }
    }
  }

  /// Medians of one size and round, by road.
  struct Turn {
    std::map<std::string, double> us, bridge_us;
  };
  Turn turn(std::size_t size) {
    std::map<std::string, std::vector<double>> times;
    std::map<std::string, double> cpu;
    for (std::size_t i = 0; i < options_.messages; ++i) {
      for (std::size_t j = 0; j < roads.size(); ++j) {
        const char* const road = roads[(i + j) % roads.size()];
        std::this_thread::sleep_for(between_messages);
        const double before = cpu_ms_of(bridge_.pid());
        const auto ns = send(road, size, patience);
        if (!ns) give_up(std::string("a message did not come on the road ") + road);
        times[road].push_back(static_cast<double>(*ns) / 1e3);
        cpu[road] += (cpu_ms_of(bridge_.pid()) - before) * 1e3;
      }
    }
    Turn result;
    for (const char* const road : roads) {
      result.us[road] = median(times[road]);
      result.bridge_us[road] = cpu[road] / static_cast<double>(options_.messages);
    }
    return result;
  }

 private:
  std::vector<std::string> variables() const {
    return {"AGNOCAST_SOCKET=" + daemon_.socket_path(), "CYCLONEDDS_URI=" + uri_,
            "ROS_DOMAIN_ID=0"};
  }
  std::string make_uri() const {
    std::string text = dds_configuration;
    text.replace(text.find("PACKETS"), 7, options_.is_large_packets ? large_packets : "");
    text.replace(text.find("TAG"), 3, "bridge-bench-" + std::to_string(::getpid()));
    return text;
  }

  const Options options_;
  const std::string uri_ = make_uri();
  test::DaemonProcess daemon_{
      {.config = "[heap]\nwindow_bytes = \"1GiB\"\narena_bytes = \"256GiB\"\n"}};
  SteeredProcess bridge_, receiver_, sender_;
  std::uint64_t number_ = 0;
};

int measure(const Options& options, const std::string& self) {
  Conductor conductor(options, self);
  conductor.warm_up();
  nlohmann::json results = nlohmann::json::array();
  std::printf("microseconds, median of %zu rounds of %zu messages%s\n", options.rounds,
              options.messages, options.is_large_packets ? "; large packets" : "");
  std::printf("%10s %10s %10s %10s %11s %11s %13s %13s\n", "bytes", "native", "out", "in",
              "out/native", "in/native", "bridge, out", "bridge, in");
  for (const std::size_t size : sizes) {
    if (size > options.largest) break;
    std::map<std::string, std::vector<double>> us, ratio, cpu;
    for (std::size_t round = 0; round < options.rounds; ++round) {
      const Conductor::Turn turn = conductor.turn(size);
      for (const char* const road : roads) {
        us[road].push_back(turn.us.at(road));
        ratio[road].push_back(turn.us.at(road) / turn.us.at("native"));
        cpu[road].push_back(turn.bridge_us.at(road));
      }
    }
    std::printf("%10zu %10.0f %10.0f %10.0f %11.2f %11.2f %13.0f %13.0f\n", size,
                median(us["native"]), median(us["out"]), median(us["in"]), median(ratio["out"]),
                median(ratio["in"]), median(cpu["out"]), median(cpu["in"]));
    std::fflush(stdout);
    for (const char* const road : roads)
      results.push_back({{"case", "bridge"},
                         {"road", road},
                         {"size_bytes", size},
                         {"large_packets", options.is_large_packets},
                         {"samples", options.rounds * options.messages},
                         {"p50_us", median(us[road])},
                         {"ratio_to_native", median(ratio[road])},
                         {"bridge_cpu_us", median(cpu[road])}});
  }
  if (!options.json.empty() &&
      !(std::ofstream(options.json) << nlohmann::json{{"results", results}}.dump(2) << '\n'))
    give_up(options.json + " cannot be written");
  return 0;
}

}  // namespace
}  // namespace agnocast::bench

int main(int argc, char** argv) {
  using namespace agnocast::bench;
  Options options;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const auto number = [&] {
      return std::strtoul(word.substr(word.find('=') + 1).c_str(), nullptr, 10);
    };
    if (word == "--role=sender") return be_sender();
    if (word == "--role=receiver") return be_receiver();
    if (word.starts_with("--rounds=")) {
      options.rounds = number();
    } else if (word.starts_with("--messages=")) {
      options.messages = number();
    } else if (word.starts_with("--largest=")) {
      options.largest = number();
    } else if (word == "--large-packets") {
      options.is_large_packets = true;
    } else if (word.starts_with("--json=")) {
      options.json = word.substr(word.find('=') + 1);
    } else {
      std::fputs(
          "bridge_bench [--rounds=N] [--messages=N] [--largest=BYTES] [--large-packets] "
          "[--json=FILE]\n",
          stderr);
      return word == "--help" ? 0 : 2;
    }
  }
  if (options.rounds == 0 || options.messages == 0) return 2;
  return measure(options, "/proc/self/exe");
}
