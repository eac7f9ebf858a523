// SPDX-License-Identifier: Apache-2.0
//
// Who measures where: the sender's thread on the first core, the receiving process on the others, so that each message of
// each system wakes an idle core. Left to the scheduler, a thread that a socket wakes often runs on the sender's core, and
// one that a doorbell wakes does not: then the comparison is between places and not between systems.
#pragma once

#include <sched.h>

#include <cstddef>

namespace demo {

/// The cores that this process may use; those that begin with the second are none where there is only one.
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

/// The calling thread goes to the first core. Where there is only one, nothing changes.
inline void take_first_core() noexcept {
  const Cores cores = own_cores();
  if (cores.are_several) (void)::sched_setaffinity(0, sizeof cores.first, &cores.first);
}
/// The calling thread, and those that it makes, leave the first core to the sender.
inline void leave_first_core() noexcept {
  const Cores cores = own_cores();
  if (cores.are_several) (void)::sched_setaffinity(0, sizeof cores.others, &cores.others);
}

}  // namespace demo
