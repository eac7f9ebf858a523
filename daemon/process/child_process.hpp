// SPDX-License-Identifier: Apache-2.0
//
// What /proc says of the first thread of a child. Reading it takes no lock of the child's memory.
#pragma once

#include <sys/types.h>

#include <cstdint>

namespace agnocast::daemon {

/// Returns the state of the first thread, as in /proc/PID/stat; 0 if unknown.
char state_of_first_thread(pid_t pid) noexcept;
/// Returns whether the first thread has ended. Others may still run.
bool first_thread_has_ended(pid_t pid) noexcept;

/// How long the first thread has run, and has waited for a processor, since it began. A wait counts
/// once it is over. Zeros where the kernel does not count it.
struct ProcessorTime {
  std::uint64_t ran_ns = 0, waited_ns = 0;
};
/// Returns the first two figures of schedstat (Linux, Documentation/scheduler/sched-stats.rst).
ProcessorTime processor_time_of(pid_t pid) noexcept;

}  // namespace agnocast::daemon
