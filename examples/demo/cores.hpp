// SPDX-License-Identifier: Apache-2.0
//
// Placement of the measurement: the sender's thread on the first core, the receiving process on
// the others, so that each message of each system wakes an idle core. The scheduler alone often
// puts a thread woken by a socket on the sender's core, and one woken by a doorbell on another
// one: the comparison would then be between placements, not systems.
#pragma once

#include <sched.h>

#include <cstddef>

namespace demo {

/// The cores that this process may use; `others` is empty if there is only one.
struct Cores {
  cpu_set_t first, others;
  bool are_several = false;
};
inline Cores own_cores() noexcept {
  Cores cores;
  CPU_ZERO(&cores.first);
  CPU_ZERO(&cores.others);
  cpu_set_t all;
  if (::sched_getaffinity(0, sizeof all, &all) != 0) return cores;
  for (std::size_t core = 0; core < CPU_SETSIZE; ++core) {
    if (!CPU_ISSET(core, &all)) continue;
    cpu_set_t* const set = CPU_COUNT(&cores.first) == 0 ? &cores.first : &cores.others;
    CPU_SET(core, set);
  }
  cores.are_several = CPU_COUNT(&cores.others) > 0;
  return cores;
}

/// Moves the calling thread to the first core. Does nothing if there is only one.
inline void take_first_core() noexcept {
  const Cores cores = own_cores();
  if (cores.are_several) (void)::sched_setaffinity(0, sizeof cores.first, &cores.first);
}
/// Leaves the first core to the sender: moves the calling thread, and threads it creates, to the
/// others.
inline void leave_first_core() noexcept {
  const Cores cores = own_cores();
  if (cores.are_several) (void)::sched_setaffinity(0, sizeof cores.others, &cores.others);
}

}  // namespace demo
