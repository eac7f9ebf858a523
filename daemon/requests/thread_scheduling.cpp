// SPDX-License-Identifier: Apache-2.0

#include <daemon/requests/thread_scheduling.hpp>

#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <linux/sched.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <optional>

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

/// Returns the effective user of a thread of the process; nothing: it has no such thread.
std::optional<uid_t> user_of(pid_t pid, std::uint32_t thread) noexcept {
  char path[64];
  std::snprintf(path, sizeof path, "/proc/%d/task/%u/status", pid, thread);
  const UniqueFd status(::open(path, O_RDONLY | O_CLOEXEC));
  char text[4096];  // the line is among the first ten
  const ssize_t count = status ? ::read(status.get(), text, sizeof text - 1) : -1;
  if (count <= 0) return std::nullopt;
  text[count] = '\0';
  const char* const line = std::strstr(text, "\nUid:");
  unsigned real = 0, effective = 0;
  if (line == nullptr || std::sscanf(line, "\nUid: %u %u", &real, &effective) != 2)
    return std::nullopt;
  return effective;
}

bool is_thread_of(const ThreadOwner& owner, std::uint32_t thread) noexcept {
  return owner.pid != 0 && user_of(owner.pid, thread) == owner.uid && !owner.process.ended();
}

bool is_real_time(std::uint32_t policy) noexcept {
  return policy == SCHED_FIFO || policy == SCHED_RR || policy == SCHED_DEADLINE;
}

/// Returns an errno; 0: done.
int set_attributes(pid_t thread, const ThreadScheduling& wanted) noexcept {
  Attributes attributes{};
  if (::syscall(SYS_sched_getattr, thread, &attributes, sizeof attributes, 0) != 0) return errno;
  attributes.size = sizeof attributes;
  // The kernel tells no nice value of a real-time thread here.
  if (is_real_time(attributes.policy))
    attributes.nice = ::getpriority(PRIO_PROCESS, static_cast<id_t>(thread));
  if (wanted.sets_policy != 0) {
    attributes.policy = wanted.policy;
    attributes.priority = wanted.priority;
    attributes.runtime_ns = wanted.runtime_ns;
    attributes.deadline_ns = wanted.deadline_ns;
    attributes.period_ns = wanted.period_ns;
  }
  if (wanted.sets_nice != 0) attributes.nice = static_cast<std::int32_t>(wanted.nice);
  // Only then: without CAP_SYS_NICE the process could not change its policy any more.
  if (is_real_time(attributes.policy) || attributes.nice < 0)
    attributes.flags |= SCHED_FLAG_RESET_ON_FORK;
  return ::syscall(SYS_sched_setattr, thread, &attributes, 0) == 0 ? 0 : errno;
}

int set_processors(pid_t thread, const std::uint64_t* cpus, std::size_t bytes) noexcept {
  return ::syscall(SYS_sched_setaffinity, thread, bytes, cpus) == 0 ? 0 : errno;
}

}  // namespace

CallbackThreads::Outcome set_scheduling(const ThreadOwner& owner, std::uint32_t thread,
                                        const ThreadScheduling& wanted) noexcept {
  if (!is_thread_of(owner, thread)) return {ThreadSetting::not_found};
  const auto number = static_cast<pid_t>(thread);
  CallbackThreads::Outcome outcome{ThreadSetting::applied};
  ThreadCall made = ThreadCall::none;
  const auto note = [&](int error, ThreadCall call) {
    if (error != 0) {
      outcome = {ThreadSetting::refused, call, error};
    } else {
      made = call;
    }
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
  if (!is_thread_of(owner, thread)) return {ThreadSetting::not_found, made};
  return outcome;
}

}  // namespace agnocast::daemon
