// SPDX-License-Identifier: Apache-2.0

#include <daemon/requests/thread_scheduling.hpp>

#include <linux/sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace agnocast::daemon {
namespace {

using abi::wire::ThreadCall;
using abi::wire::ThreadScheduling;
using abi::wire::ThreadSetting;

// As sched_setattr(2) has it (SCHED_ATTR_SIZE_VER0); glibc before 2.41 does not declare it.
struct Attributes {
  std::uint32_t size;
  std::uint32_t policy;
  std::uint64_t flags;
  std::int32_t nice;
  std::uint32_t priority;
  std::uint64_t runtime_ns;
  std::uint64_t deadline_ns;
  std::uint64_t period_ns;
};
static_assert(sizeof(Attributes) == 48);

bool is_thread_of(const Pidfd& process, pid_t pid, std::uint32_t thread) noexcept {
  if (pid == 0 || thread == 0 || process.ended()) return false;
  // Signal 0 only checks. Any other error means: it is there, and may not be sent signals.
  return ::syscall(SYS_tgkill, pid, static_cast<pid_t>(thread), 0) == 0 || errno != ESRCH;
}

/// Returns an errno; 0: done.
int set_attributes(pid_t thread, const ThreadScheduling& wanted) noexcept {
  Attributes attributes{};
  if (::syscall(SYS_sched_getattr, thread, &attributes, sizeof attributes, 0) != 0) return errno;
  attributes.size = sizeof attributes;
  attributes.flags |= SCHED_FLAG_RESET_ON_FORK;
  if (wanted.sets_policy != 0) {
    attributes.policy = wanted.policy;
    attributes.priority = wanted.priority;
    attributes.runtime_ns = wanted.runtime_ns;
    attributes.deadline_ns = wanted.deadline_ns;
    attributes.period_ns = wanted.period_ns;
  }
  if (wanted.sets_nice != 0) attributes.nice = static_cast<std::int32_t>(wanted.nice);
  return ::syscall(SYS_sched_setattr, thread, &attributes, 0) == 0 ? 0 : errno;
}

int set_processors(pid_t thread, const std::uint64_t* cpus, std::size_t bytes) noexcept {
  return ::syscall(SYS_sched_setaffinity, thread, bytes, cpus) == 0 ? 0 : errno;
}

}  // namespace

CallbackThreads::Outcome set_scheduling(const Pidfd& process, pid_t pid, std::uint32_t thread,
                                        const ThreadScheduling& wanted) noexcept {
  if (!is_thread_of(process, pid, thread)) return {ThreadSetting::not_found};
  const auto number = static_cast<pid_t>(thread);
  CallbackThreads::Outcome outcome{ThreadSetting::applied};
  const auto note = [&](int error, ThreadCall call) {
    if (error != 0) outcome = {ThreadSetting::refused, call, error};
    return error == 0;
  };
  // A deadline thread must be allowed on all processors of its root domain (sched(7)), also after
  // another rule has bound it.
  std::uint64_t all[sizeof wanted.cpus / sizeof wanted.cpus[0]];
  std::memset(all, 0xff, sizeof all);
  if (wanted.sets_policy != 0 && wanted.policy == SCHED_DEADLINE)
    note(set_processors(number, all, sizeof all), ThreadCall::sched_setaffinity);
  const bool is_set = (wanted.sets_policy == 0 && wanted.sets_nice == 0) ||
                      note(set_attributes(number, wanted), ThreadCall::sched_setattr);
  if (is_set && wanted.sets_cpus != 0)
    note(set_processors(number, wanted.cpus, sizeof wanted.cpus), ThreadCall::sched_setaffinity);
  return is_thread_of(process, pid, thread) ? outcome
                                            : CallbackThreads::Outcome{ThreadSetting::not_found};
}

}  // namespace agnocast::daemon
