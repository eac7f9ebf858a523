// SPDX-License-Identifier: Apache-2.0
//
// The systems of this build.

#include <bench/system.hpp>

namespace agnocast::bench {

const std::vector<System>& systems() {
  static const std::vector<System> all = [] {
    std::vector<System> made;
    const auto append = [&made](const std::vector<System>& more) {
      made.insert(made.end(), more.begin(), more.end());
    };
#ifdef AGNOCAST_BENCH_HAS_FLOORS
    append(floor_systems());
#endif
#ifdef AGNOCAST_BENCH_HAS_AGNOCAST
    append(agnocast_systems());
#endif
#ifdef AGNOCAST_BENCH_HAS_CYCLONEDDS
    append(cyclonedds_systems());
#endif
#ifdef AGNOCAST_BENCH_HAS_ICEORYX
    append(iceoryx_systems());
#endif
    return made;
  }();
  return all;
}

std::vector<std::string> absent() {
  std::vector<std::string> all;
#ifndef AGNOCAST_BENCH_HAS_CYCLONEDDS
  all.emplace_back("cyclonedds: left out, cyclonedds-dev was not installed when this was built");
#endif
#ifndef AGNOCAST_BENCH_HAS_ICEORYX
  all.emplace_back("iceoryx: left out, libiceoryx-posh-dev was not installed when this was built");
#endif
  return all;
}

}  // namespace agnocast::bench
