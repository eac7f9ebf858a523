// SPDX-License-Identifier: Apache-2.0
//
// A subscriber of the demo. Checks the seal of every message and prints a line for each:
//
//   received NUMBER intact|WRONG PLACES        of /demo/cloud; PLACES: its addresses here
//
// It also checks messages of /demo/latency, and answers them through the pipe at descriptor 3
// (ack.hpp); those of Cyclone DDS likewise. Ends at the end of its standard input, with "done
// RECEIVED WRONG LOST" and status 1 if a message was wrong.
//
//   demo_subscriber NAME [latency [dds]]

#include <agnocast/agnocast.hpp>
#include <examples/demo/ack.hpp>
#include <examples/demo/content.hpp>
#include <examples/demo/cores.hpp>
#include <examples/demo/dds_road.hpp>

#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <string_view>

namespace demo {
namespace {

using CloudPointer = agnocast::ipc_shared_ptr<const Cloud>;

struct Counts {
  std::atomic<std::uint64_t> received{0};
  std::atomic<std::uint64_t> wrong{0};
  void add(bool intact) noexcept {
    ++received;
    if (!intact) ++wrong;
  }
};

void answer(Road road, std::uint64_t number, bool intact, std::uint64_t received_ns) {
  const Ack ack{number, received_ns, road, intact};
  // Shorter than PIPE_BUF, so it arrives whole. If the publisher is gone, the demo notices.
  [[maybe_unused]] const auto written = ::write(ack_descriptor, &ack, sizeof ack);
}

void say(const char* text) {
  std::puts(text);
  std::fflush(stdout);
}

int run(const char* name, bool with_latency, bool with_dds) {
  if (with_latency) leave_first_core();  // before anything makes a thread
  agnocast::Node node(name);
  agnocast::BackgroundExecutor executor;  // this thread reads standard input
  executor.add_node(node);
  Counts counts;
  // Keep-all with a small bound: nothing may be lost, so the publisher waits for the slower one.
  auto clouds = agnocast::create_subscription<Cloud>(
      node, "/demo/cloud", agnocast::QoS(1).keep_all(4), [&](const CloudPointer& cloud) {
        const bool intact = is_intact<RosAccess>(*cloud);
        counts.add(intact);
        std::printf("received %llu %s %s\n", static_cast<unsigned long long>(number_of(*cloud)),
                    intact ? "intact" : "WRONG", places_of(*cloud).c_str());
        std::fflush(stdout);
      });
  agnocast::Subscription<Cloud>::SharedPtr timed;
  std::unique_ptr<DdsReader> dds;
  if (with_latency) {
    timed = agnocast::create_subscription<Cloud>(
        node, "/demo/latency", agnocast::QoS(1), [&](const CloudPointer& cloud) {
          const std::uint64_t received_ns = now_ns();
          const bool intact = is_intact<RosAccess>(*cloud);
          counts.add(intact);
          answer(Road::agnocast, number_of(*cloud), intact, received_ns);
        });
  }
  if (with_dds) {
    std::string why;
    dds = DdsReader::make(
        "rt/demo/latency",
        [&](std::uint64_t number, bool intact, std::uint64_t received_ns) {
          counts.add(intact);
          answer(Road::dds, number, intact, received_ns);
        },
        why);
    if (dds == nullptr) say(("no_dds " + why).c_str());
  }
  say("ready");
  while (std::getchar() != EOF) continue;
  dds.reset();
  timed.reset();
  const std::uint64_t lost = clouds->get_lost_count();
  clouds.reset();
  std::printf("done %llu %llu %llu\n", static_cast<unsigned long long>(counts.received),
              static_cast<unsigned long long>(counts.wrong), static_cast<unsigned long long>(lost));
  return counts.wrong == 0 ? 0 : 1;
}

}  // namespace
}  // namespace demo

int main(int argc, char** argv) try {
  const auto has = [&](int place, std::string_view word) {
    return argc > place && argv[place] == word;
  };
  if (argc < 2 || has(1, "--help")) {
    std::fputs("usage: demo_subscriber NAME [latency [dds]]   (started by the demo)\n", stderr);
    return 2;
  }
  return demo::run(argv[1], has(2, "latency"), has(3, "dds"));
} catch (const agnocast::Error& error) {
  std::fprintf(stderr, "demo_subscriber: %s\nhint: %s\n", error.what(),
               agnocast::remedy_of(error.failure().code));
  return 1;
}
