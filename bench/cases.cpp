// SPDX-License-Identifier: Apache-2.0
//
// The cases of this build, in the order in which `agnocast-bench all` runs them, and the options
// that each of them reads.

#include <bench/cases.hpp>
#include <bench/cases/rmw.hpp>
#include <bench/cases/ros2.hpp>
#include <bench/cases/throughput.hpp>
#include <bench/pipeline/edge.hpp>
#include <bench/system.hpp>

namespace agnocast::bench {
namespace {

std::vector<SystemName> named(const std::vector<System>& all) {
  std::vector<SystemName> names;
  names.reserve(all.size());
  for (const System& one : all) names.push_back({one.name, one.summary});
  return names;
}

std::vector<SystemName> of_most() { return named(systems()); }
// Without those that copy for every receiver: they are known to be slower.
std::vector<SystemName> of_fanout() {
  std::vector<SystemName> names = of_most();
  std::erase_if(names, [](const SystemName& one) { return one.name == "floor-memcpy"; });
  return names;
}
std::vector<SystemName> of_throughput() { return named(throughput::systems()); }
std::vector<SystemName> of_ros2() { return named(ros2::systems()); }
std::vector<SystemName> of_rmw() { return named(rmw::systems()); }
std::vector<SystemName> of_pipeline() {
  std::vector<SystemName> names;
  for (const pipeline::Edge& edge : pipeline::edges()) names.push_back({edge.name, {}});
  return names;
}

}  // namespace

/// Long because it is the table of all cases.
const std::vector<Case>& cases() {
  using std::chrono::seconds;
  static const std::vector<Case> all = {
#ifdef AGNOCAST_BENCH_HAS_LATENCY
      {"latency",
       "one to one: notification on one core, sizes on two, bare calls, across users",
       seconds(1200),
       run_latency,
       {"--rounds", "--messages", "--period", "--sizes", "--systems"},
       of_most},
#endif
#ifdef AGNOCAST_BENCH_HAS_THROUGHPUT
      {"throughput",
       "messages and bytes a second, back to back",
       seconds(420),
       run_throughput,
       {"--rounds", "--sizes", "--systems"},
       of_throughput,
       SIZE_MAX,
       {throughput::small_bytes, throughput::large_bytes}},
#endif
#ifdef AGNOCAST_BENCH_HAS_FANOUT
      {"fanout",
       "one to many: the cost of each further receiver, asleep and awake",
       seconds(660),
       run_fanout,
       {"--rounds", "--messages", "--period", "--sizes", "--systems"},
       of_fanout,
       1},
#endif
#ifdef AGNOCAST_BENCH_HAS_LOAD
      {"load",
       "latency while the machine is busy",
       seconds(1020),
       run_load,
       {"--rounds", "--messages", "--period", "--sizes", "--systems"},
       of_most},
#endif
#ifdef AGNOCAST_BENCH_HAS_ALLOC
      {"alloc",
       "malloc and free in the shared heap beside private memory",
       seconds(60),
       run_alloc,
       {"--rounds"}},
#endif
#ifdef AGNOCAST_BENCH_HAS_MEMORY
      {"memory",
       "the cost of pages, and the memory returned after a spike",
       seconds(135),
       run_memory,
       {"--rounds"}},
#endif
#ifdef AGNOCAST_BENCH_HAS_SCALE
      {"scale",
       "the cost of more subscribers, publishers, topics and processes",
       seconds(120),
       run_scale,
       {"--rounds", "--messages"}},
#endif
#ifdef AGNOCAST_BENCH_HAS_DEATH
      {"death",
       "the cost of deaths for the remaining processes",
       seconds(240),
       run_death,
       {"--rounds", "--sizes"},
       nullptr,
       1},
#endif
#ifdef AGNOCAST_BENCH_HAS_BRIDGE
      {"bridge",
       "the cost of the bridge to DDS beside Cyclone DDS alone",
       seconds(120),
       run_bridge,
       {"--rounds", "--messages", "--sizes"}},
#endif
#ifdef AGNOCAST_BENCH_HAS_PIPELINE
      {"pipeline",
       "Autoware's LiDAR preprocessing, over Cyclone DDS and agnocast",
       seconds(185),
       run_pipeline,
       {"--messages", "--period", "--systems", "--scan"},
       of_pipeline},
#endif
#ifdef AGNOCAST_BENCH_HAS_ROS2
      {"ros2",
       "agnocast_rclcpp beside our own executor, rclcpp over DDS and within a process",
       seconds(300),
       run_ros2,
       {"--rounds", "--messages", "--period", "--sizes", "--systems"},
       of_ros2},
      {"rmw",
       "unchanged rclcpp nodes over rmw_agnocast_cpp and over rmw_cyclonedds_cpp",
       seconds(300),
       run_rmw,
       {"--rounds", "--messages", "--period", "--sizes", "--systems"},
       of_rmw},
#endif
  };
  return all;
}

}  // namespace agnocast::bench
