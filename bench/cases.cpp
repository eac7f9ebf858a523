// SPDX-License-Identifier: Apache-2.0
//
// Which cases this build has, in the order in which `agnocast-bench all` runs them.

#include <bench/cases.hpp>

namespace agnocast::bench {

const std::vector<Case>& cases() {
  using std::chrono::seconds;
  static const std::vector<Case> all = {
#ifdef AGNOCAST_BENCH_HAS_LATENCY
      {"latency", "one to one: notification on one core, sizes on two, bare calls, across users",
       seconds(1100), run_latency},
#endif
#ifdef AGNOCAST_BENCH_HAS_THROUGHPUT
      {"throughput", "messages and bytes a second, back to back", seconds(420), run_throughput},
#endif
#ifdef AGNOCAST_BENCH_HAS_FANOUT
      {"fanout", "one to many: what each further receiver costs, asleep and awake", seconds(420),
       run_fanout},
#endif
#ifdef AGNOCAST_BENCH_HAS_LOAD
      {"load", "latency while the machine is busy", seconds(420), run_load},
#endif
#ifdef AGNOCAST_BENCH_HAS_ALLOC
      {"alloc", "malloc and free in the shared heap beside private memory", seconds(60), run_alloc},
#endif
#ifdef AGNOCAST_BENCH_HAS_MEMORY
      {"memory", "what pages cost, and what comes back after a spike", seconds(60), run_memory},
#endif
#ifdef AGNOCAST_BENCH_HAS_SCALE
      {"scale", "what more subscribers, publishers, topics and processes cost", seconds(120),
       run_scale},
#endif
#ifdef AGNOCAST_BENCH_HAS_DEATH
      {"death", "what deaths cost those who live", seconds(240), run_death},
#endif
#ifdef AGNOCAST_BENCH_HAS_BRIDGE
      {"bridge", "what the bridge to DDS costs beside Cyclone DDS alone", seconds(120), run_bridge},
#endif
#ifdef AGNOCAST_BENCH_HAS_PIPELINE
      {"pipeline", "Autoware's LiDAR preprocessing, over Cyclone DDS and agnocast", seconds(185),
       run_pipeline},
#endif
  };
  return all;
}

}  // namespace agnocast::bench
