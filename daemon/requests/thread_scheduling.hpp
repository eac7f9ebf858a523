// SPDX-License-Identifier: Apache-2.0
//
// Thread scheduling: policy, priority, nice value and processors of a thread of another process.
//
// A thread has no descriptor: the calls take its number, which the process said. So the number is
// checked before and after: it must be a thread of the process of this pid, whose pidfd says that
// it has not ended. Between the checks a thread could end, and its number go to another process
// after the kernel has given away all others; the caller is then told that the thread was not
// found.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <base/descriptors/pidfd.hpp>
#include <daemon/state/callback_threads.hpp>

#include <sys/types.h>

#include <cstdint>

namespace agnocast::daemon {

/// Applies `wanted`; what it does not set stays. With SCHED_FLAG_RESET_ON_FORK: threads and
/// processes that the thread starts get no real-time policy and no negative nice value. Returns
/// applied, refused or not_found. About five system calls, none of which waits for the process.
CallbackThreads::Outcome set_scheduling(const Pidfd& process, pid_t pid, std::uint32_t thread,
                                        const abi::wire::ThreadScheduling& wanted) noexcept;

}  // namespace agnocast::daemon
