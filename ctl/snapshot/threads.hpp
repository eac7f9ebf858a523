// SPDX-License-Identifier: Apache-2.0
//
// Threads: the threads that run callbacks. The daemon knows their processes, executors and rules;
// what is in force is read back from the kernel, with sched_getattr(2) and sched_getaffinity(2).
//
// A process names its threads by the numbers of its own pid namespace. They are looked for below
// /proc/PID/task, so that a thread of another process is never shown.
#pragma once

#include <ctl/cli/arguments.hpp>
#include <ctl/snapshot/system.hpp>

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace agnocast::ctl {

/// How the kernel schedules a thread.
struct KernelThread {
  std::uint32_t policy = 0;    // SCHED_OTHER, SCHED_FIFO, …
  std::uint32_t priority = 0;  // of SCHED_FIFO and SCHED_RR
  std::int32_t nice = 0;       // of the other policies, without SCHED_DEADLINE
  std::uint64_t runtime_ns = 0, deadline_ns = 0, period_ns = 0;  // of SCHED_DEADLINE
  bool reset_on_fork = false;
  std::vector<std::uint32_t> cpus;  // that it may run on, ascending
  std::uint64_t cpu_time_ns = 0;    // that it has run
};

/// The threads of one process in /proc.
class ProcessThreads {
 public:
  explicit ProcessThreads(const wire::DumpProcess& process);
  /// Returns what the kernel says of the thread with this number in the pid namespace of its
  /// process. Nothing: the process or thread has ended, is not visible here, or may not be asked.
  std::optional<KernelThread> find(std::uint32_t thread) const;

 private:
  pid_t pid_ = 0;  // 0: not visible
  bool is_translated_ = false;
  std::map<std::uint32_t, pid_t> here_;  // of a process in another pid namespace
};

/// A thread that runs callbacks. In rclcpp each callback group is an executor of ours, which all
/// threads of rclcpp's executor spin: its process could name millions of pairs of a thread and a
/// group. So a thread has the first executors and groups only, if there are very many.
struct CallbackThread {
  const Process* process = nullptr;
  const wire::DumpCallbackThread* facts = nullptr;  // with the number of all its executors
  std::span<const std::uint64_t> executors;         // ascending
  std::vector<const CallbackGroup*> groups;         // of all its executors, by executor and number
  std::uint64_t group_count = 0;                    // of all
  std::optional<KernelThread> kernel;

  bool has_rule() const noexcept { return facts->setting != wire::ThreadSetting::no_rule; }
};

/// The most executors, and groups, that the threads of one threads_of() have together: as many for
/// each thread, and one at least.
inline constexpr std::size_t shown_of_threads_max = std::size_t{1} << 17;

/// Returns the threads of the domain or of all domains, by process and number. The system must be
/// a look with LookOptions::threads, and outlive them.
std::vector<CallbackThread> threads_of(const System& system, const Arguments& arguments);

/// Returns the name of a scheduling policy as chrt(1) has it, without SCHED_: "fifo".
std::string policy_word(std::uint32_t policy);
/// Returns what goes with the policy: "50" of fifo and rr; "2.0 ms/8.0 ms/10.0 ms" (runtime,
/// deadline, period) of deadline; else "nice -5".
std::string priority_words(const KernelThread& thread);
/// Returns "0-3,6" for ascending numbers.
std::string cpu_list(std::span<const std::uint32_t> cpus);
/// Returns the processors that a rule sets, ascending.
std::vector<std::uint32_t> cpus_of(const wire::ThreadScheduling& scheduling);

/// What the kernel has otherwise than a rule wants it.
struct Difference {
  std::string words;               // "policy other instead of fifo, processors 0 instead of 0-3"
  bool only_cpus_missing = false;  // the thread may run on some of the wanted processors only
  explicit operator bool() const noexcept { return !words.empty(); }
};
Difference difference_of(const wire::ThreadScheduling& wanted, const KernelThread& is);

/// Returns "due", "applied", "not_allowed", "refused" or "not_found"; of no_rule: "no_rule".
const char* word_of(wire::ThreadSetting setting) noexcept;
/// Returns the name of the system call; nullptr: none.
const char* word_of(wire::ThreadCall call) noexcept;
/// Returns "rule at line 12", of the file that the daemon has read.
std::string rule_words(const wire::DumpCallbackThread& thread);

}  // namespace agnocast::ctl
