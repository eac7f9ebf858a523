// SPDX-License-Identifier: Apache-2.0
//
// The check of the threads that run callbacks: each rule for threads is in force.

#include <base/text/text.hpp>
#include <ctl/cli/console.hpp>
#include <ctl/doctor/doctor_facts.hpp>
#include <ctl/snapshot/threads.hpp>

#include <sched.h>

#include <algorithm>
#include <cerrno>
#include <limits>
#include <map>
#include <system_error>
#include <tuple>

namespace agnocast::ctl {
namespace {

using Ailments = std::vector<Ailment>;
using wire::ThreadCall;
using wire::ThreadScheduling;
using wire::ThreadSetting;

// Numbers of threads that a finding names; the others are counted.
constexpr std::size_t named_threads_max = 4;

/// What is wrong with the rule of a thread, without the thread: many have the same.
struct Trouble {
  std::string what, cause, remedy;
  bool operator<(const Trouble& other) const {
    return std::tie(what, cause, remedy) < std::tie(other.what, other.cause, other.remedy);
  }
};

std::string with_common(const Facts& facts, std::string_view remedy, const Fill& words = {}) {
  return filled(remedy, words, facts.common());
}

std::string edit_rule(const Facts& facts, const wire::DumpCallbackThread& thread) {
  return with_common(facts, "sudo \"${EDITOR:-vi}\" +LINE FILE && RELOAD",
                     {{"LINE", std::to_string(thread.rule)}});
}

bool is_realtime(const ThreadScheduling& wanted) {
  return wanted.sets_policy != 0 && (wanted.policy == SCHED_FIFO || wanted.policy == SCHED_RR);
}
bool has_deadline(const ThreadScheduling& wanted) {
  return wanted.sets_policy != 0 && wanted.policy == SCHED_DEADLINE;
}

/// Returns options of prlimit(1) with which the process permits the scheduling to other processes
/// of its user; empty: no limit permits it.
std::string limits_for(const ThreadScheduling& wanted) {
  std::string limits;
  if (is_realtime(wanted)) limits += " --rtprio=" + std::to_string(wanted.priority);
  // RLIMIT_NICE counts from 20 down.
  if (wanted.sets_nice != 0 && wanted.nice < 0)
    limits += " --nice=" + std::to_string(20 - wanted.nice);
  return limits;
}

/// Returns why the kernel answers EPERM to an agnocastd with CAP_SYS_NICE. No remedy lifts
/// kernel.sched_rt_runtime_us: it keeps real-time threads from stopping the whole machine.
const char* cause_with_capability(const ThreadScheduling& wanted) {
  if (has_deadline(wanted))
    return "a deadline thread must be allowed on all processors of its root domain (sched(7)): "
           "the process is bound to some of them (its cpuset)";
  if (is_realtime(wanted))
    return "the control group of the process has no time for real-time threads (its "
           "cpu.rt_runtime_us, with CONFIG_RT_GROUP_SCHED), or a security profile or the unit of "
           "agnocastd (RestrictRealtime=) forbids the call";
  return "a security profile forbids the call to agnocastd, or it runs in a user namespace";
}

/// The kernel answered EPERM. No remedy gives CAP_SYS_NICE to the file of agnocastd: every user
/// could then start it with rules of his own.
Trouble not_permitted(const Facts& facts, const CallbackThread& thread) {
  const wire::DumpCallbackThread& about = *thread.facts;
  const ThreadScheduling& wanted = about.scheduling;
  const wire::DumpProcess& process = thread.process->facts;
  const bool is_capable = facts.daemon.may_schedule_all;
  if (is_capable && (has_deadline(wanted) || is_realtime(wanted) || !facts.door.is_systems))
    return {{}, cause_with_capability(wanted), edit_rule(facts, about)};
  if (facts.door.is_systems)
    return {{},
            "agnocastd has no CAP_SYS_NICE, or its unit or a security profile forbids the call",
            with_common(facts,
                        "sudo mkdir -p /etc/systemd/system/agnocastd.service.d && printf "
                        "'[Service]\\nCapabilityBoundingSet=CAP_SYS_NICE\\nSystemCallFilter=sched_"
                        "setattr sched_setaffinity\\nRestrictRealtime=no\\n' | sudo tee "
                        "/etc/systemd/system/agnocastd.service.d/threads.conf && sudo systemctl "
                        "daemon-reload && RELOAD")};
  const std::string limits = limits_for(wanted);
  if (about.call == ThreadCall::sched_setattr && process.uid == facts.system().daemon.uid &&
      process.pid != 0 && !limits.empty() && !has_deadline(wanted))
    return {{},
            "agnocastd has no CAP_SYS_NICE, and the limits of the process (RLIMIT_RTPRIO, "
            "RLIMIT_NICE) do not permit it",
            with_common(facts, "sudo prlimit --pid PID" + limits + " && RELOAD",
                        {{"PID", std::to_string(process.pid)}})};
  return {
      {},
      "agnocastd has no CAP_SYS_NICE, and no limit of the process permits it: only the system's "
      "unit, which runs as root, has this right, or a unit with AmbientCapabilities=CAP_SYS_NICE",
      edit_rule(facts, about)};
}

std::string cause_of_refusal(const wire::DumpCallbackThread& thread) {
  const ThreadScheduling& wanted = thread.scheduling;
  const bool binds = thread.call == ThreadCall::sched_setaffinity;
  if (thread.call == ThreadCall::none)
    return "agnocastd had no free descriptor (LimitNOFILE= of its unit): it has called nothing";
  if (thread.os_errno == EBUSY && binds)
    return "it is a deadline thread, which must be allowed on all processors of its root domain "
           "(sched(7))";
  if (thread.os_errno == EBUSY)
    return "the deadline threads of this host would get more time than it has (admission control "
           "of sched(7)): lower the runtime, or that of other rules";
  if (thread.os_errno == EINVAL && binds)
    return "this host has none of the processors " + cpu_list(cpus_of(wanted)) +
           ", or the process may use none of them (its cpuset)";
  if (thread.os_errno == EINVAL)
    return "the kernel does not take these values: see sched(7) and sched_setattr(2)";
  return "see " + std::string(binds ? "sched_setaffinity" : "sched_setattr") + "(2)";
}

Trouble refused(const Facts& facts, const CallbackThread& thread) {
  const wire::DumpCallbackThread& about = *thread.facts;
  Trouble trouble{{}, cause_of_refusal(about), edit_rule(facts, about)};
  if (about.os_errno == EPERM) trouble = not_permitted(facts, thread);
  const char* const call = word_of(about.call);
  if (call == nullptr) trouble.remedy = with_common(facts, "RELOAD");
  trouble.what = std::string(call == nullptr ? "the kernel" : call) + " refused the " +
                 rule_words(about) + ": " +
                 std::generic_category().message(static_cast<int>(about.os_errno));
  return trouble;
}

/// agnocastd did not find the thread. Returns nothing (empty `what`) if it has ended since.
Trouble not_found(const CallbackThread& thread) {
  const wire::DumpCallbackThread& about = *thread.facts;
  const bool is_seen_by_daemon = thread.process->facts.pid != 0;
  if (!thread.kernel && is_seen_by_daemon) return {};
  if (about.call != ThreadCall::none)
    return {"it ended while agnocastd applied the " + rule_words(about),
            "a new thread with its number, perhaps of another process, may have the scheduling",
            "agnocast-ctl thread list --all-domains"};
  std::string cause =
      "the process is in another pid namespace than agnocastd, which does not translate numbers of "
      "threads";
  if (is_seen_by_daemon)
    cause +=
        ", or the effective user of the thread is not the one that has connected "
        "(/proc/PID/task/TID/status)";
  return {"agnocastd cannot find it, to apply the " + rule_words(about), std::move(cause),
          "podman run --pid=host IMAGE"};
}

/// Returns nothing (empty `what`) if all is well, or nothing is known.
Trouble trouble_of(const Facts& facts, const CallbackThread& thread) {
  const wire::DumpCallbackThread& about = *thread.facts;
  switch (about.setting) {
    case ThreadSetting::no_rule:
    case ThreadSetting::due:
      return {};
    case ThreadSetting::not_allowed:
      return {"the " + rule_words(about) + " matches, and is not for uid " +
                  std::to_string(thread.process->facts.uid),
              "`users` of the rule does not name this user", edit_rule(facts, about)};
    case ThreadSetting::refused:
      return refused(facts, thread);
    case ThreadSetting::not_found:
      return not_found(thread);
    case ThreadSetting::applied:
      break;
  }
  if (!thread.kernel) return {};
  const Difference difference = difference_of(about.scheduling, *thread.kernel);
  if (!difference) return {};
  const std::string what = difference.words + " (" + rule_words(about) + ")";
  if (difference.only_cpus_missing)
    return {what,
            "the other processors are not there, or the process may not use them (its cpuset)",
            edit_rule(facts, about)};
  return {what, "it was changed after the rule was applied; a reload applies all rules again",
          with_common(facts, "RELOAD")};
}

std::string numbers_of(std::vector<std::uint32_t> threads) {
  std::sort(threads.begin(), threads.end());
  std::string text = threads.size() == 1 ? "thread " : "threads ";
  const std::size_t named = std::min(threads.size(), named_threads_max);
  for (std::size_t i = 0; i < named; ++i) text += (i == 0 ? "" : ", ") + std::to_string(threads[i]);
  if (named < threads.size()) text += " and " + std::to_string(threads.size() - named) + " more";
  return text;
}

void add_rules(const Facts& facts, Ailments& found) {
  std::map<std::pair<std::uint64_t, Trouble>, std::vector<const CallbackThread*>> all;
  for (const CallbackThread& thread : facts.threads) {
    Trouble trouble = trouble_of(facts, thread);
    if (!trouble.what.empty())
      all[{thread.process->facts.client, std::move(trouble)}].push_back(&thread);
  }
  for (const auto& [key, threads] : all) {
    std::vector<std::uint32_t> numbers;
    for (const CallbackThread* const thread : threads) numbers.push_back(thread->facts->thread);
    const Trouble& trouble = key.second;
    found.push_back({numbers_of(std::move(numbers)) + " of " + words_of(*threads.front()->process) +
                         ": " + trouble.what,
                     {{"SETTING", trouble.remedy}},
                     trouble.cause});
  }
}

/// Returns the quota that the user has reached; nullptr: none.
const char* reached_quota(const Facts& facts, std::uint32_t uid, std::uint64_t& limit) {
  const wire::UserShare& quota = facts.system().daemon.quota;
  for (const wire::DumpUser& user : facts.system().users) {
    if (user.uid != uid) continue;
    for (const auto& [key, used, most] :
         {std::tuple("callback_groups", user.use.callback_groups, quota.callback_groups),
          std::tuple("callback_threads", user.use.callback_threads, quota.callback_threads)}) {
      limit = most;
      if (most != unlimited && used >= most) return key;
    }
  }
  return nullptr;
}

bool is_at_limit(const Process& process) {
  return process.callback_group_count >= abi::callback_group_count_max ||
         process.callback_thread_count >= abi::callback_thread_count_max ||
         process.callback_spin_count >= abi::callback_spin_count_max;
}

void add_left_out(const Facts& facts, Ailments& found) {
  for (const auto& [index, process] : facts.system().processes) {
    const std::uint64_t count = process.facts.threads_left_out;
    if (count == 0) continue;
    const std::string what =
        counted(count, "callback group or thread", "callback groups and threads") + " of " +
        words_of(process) + (count == 1 ? " is" : " are") + " unknown to agnocastd";
    std::uint64_t limit = 0;
    const char* const key =
        is_at_limit(process) ? nullptr : reached_quota(facts, process.facts.uid, limit);
    if (key != nullptr) {
      const std::uint64_t doubled = limit > unlimited / 4 ? limit : limit * 2;
      found.push_back({what,
                       {{"SETTING", facts.configure("quota", key, std::max(doubled, count)) +
                                        with_common(facts, " && RELOAD")}},
                       std::string("[quota] ") + key + " is " + std::to_string(limit) +
                           ": no rule for threads reaches the others"});
    } else {
      found.push_back({what,
                       {{"SETTING", "agnocast-ctl thread list --all-domains"}},
                       "a process may have " + std::to_string(abi::callback_group_count_max) +
                           " callback groups, " + std::to_string(abi::callback_thread_count_max) +
                           " threads and " + std::to_string(abi::callback_spin_count_max) +
                           " pairs of a thread and an executor, which no [quota] raises: its nodes "
                           "can be moved to several processes" +
                           (is_at_limit(process) ? ""
                                                 : ". [quota] callback_threads also limits how "
                                                   "many executors the threads of a user spin")});
    }
  }
}

Ailments settings(const Facts& facts) {
  Ailments found;
  add_rules(facts, found);
  add_left_out(facts, found);
  return found;
}

// clang-format off
constexpr Check thread_table[] = {
    {"thread-settings", "every rule for threads is in force", Check::Severity::warning, Check::Needs::daemon,
     "a rule of [[thread]] was not applied to a thread that it matches, or the thread has other values now",
     "SETTING", settings},
};
// clang-format on

}  // namespace

const std::span<const Check> thread_checks = thread_table;

}  // namespace agnocast::ctl
