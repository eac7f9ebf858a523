// SPDX-License-Identifier: Apache-2.0
//
// Thread scheduling: policy, priority, nice value and processors of a thread of another process.
//
// A thread has no descriptor: the calls take its number, which the process said. So the number is
// checked before and after: it must be a thread of this process, with the user that connected
// (/proc/PID/task), while the pidfd says that the process has not ended. Between the checks a
// thread may end, and its number go to a thread of another process, which then has the setting; if
// that was seen, the outcome is not_found with the call that was made.
//
// For threads that may wait (errands.hpp): /proc of a process can be kept locked by its user, and
// sched_setaffinity waits for its thread where the kernel is preemptible (PREEMPT_RT).
#pragma once

#include <agnocast/abi/observe.hpp>
#include <base/descriptors/pidfd.hpp>
#include <daemon/state/callback_threads.hpp>

#include <sys/types.h>

#include <cstdint>

namespace agnocast::daemon {

struct ThreadOwner {
  const Pidfd& process;
  pid_t pid;
  uid_t uid;  // effective
};

/// Applies `wanted`; what it does not set stays. A real-time policy and a negative nice value come
/// with SCHED_FLAG_RESET_ON_FORK: threads and processes that the thread starts do not have them.
/// Returns applied, refused or not_found.
CallbackThreads::Outcome set_scheduling(const ThreadOwner& owner, std::uint32_t thread,
                                        const abi::wire::ThreadScheduling& wanted) noexcept;

}  // namespace agnocast::daemon
