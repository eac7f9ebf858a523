// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/threads.hpp>

#include <ctl/cli/console.hpp>
#include <ctl/snapshot/proc_files.hpp>
#include <ctl/snapshot/select.hpp>

#include <fcntl.h>
#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <iterator>
#include <set>
#include <string_view>
#include <system_error>
#include <tuple>

namespace agnocast::ctl {
namespace {

// struct sched_attr in its first form, which every kernel fills; the C library may have none.
struct SchedulingAttributes {
  std::uint32_t size;
  std::uint32_t policy;
  std::uint64_t flags;
  std::int32_t nice;
  std::uint32_t priority;
  std::uint64_t runtime_ns, deadline_ns, period_ns;
};
static_assert(sizeof(SchedulingAttributes) == 48);
constexpr std::uint64_t flag_reset_on_fork = 1;  // SCHED_FLAG_RESET_ON_FORK

// The most that a kernel can be built for (NR_CPUS): a smaller mask would be refused.
constexpr std::size_t kernel_cpu_count_max = 8192;
using KernelMask = std::array<std::uint64_t, kernel_cpu_count_max / 64>;

constexpr std::uint64_t second_ns = 1'000'000'000;

std::vector<std::uint32_t> numbers_in(std::span<const std::uint64_t> mask) {
  std::vector<std::uint32_t> numbers;
  for (std::size_t i = 0; i < mask.size() * 64; ++i) {
    if ((mask[i / 64] >> i % 64 & 1) != 0) numbers.push_back(static_cast<std::uint32_t>(i));
  }
  return numbers;
}

/// Returns the time that a thread has run; nothing if it has ended. `directory`: of /proc.
std::optional<std::uint64_t> cpu_time_of(int directory) {
  // In nanoseconds; some kernels are built without it, or give 0.
  const auto precise = number_in(contents_at(directory, "schedstat"));
  if (precise && *precise != 0) return precise;
  const std::string stat = contents_at(directory, "stat");
  // "tid (name) state …" with the times in user and kernel mode as fields 14 and 15, in ticks; the
  // name may hold anything.
  std::string_view rest(stat);
  rest.remove_prefix(std::min(rest.rfind(')'), rest.size()));
  for (int field = 2; field < 14 && !rest.empty(); ++field)
    rest.remove_prefix(std::min(rest.find(' '), rest.size() - 1) + 1);
  const auto user = number_in(rest);
  rest.remove_prefix(std::min(rest.find(' '), rest.size()));
  const auto kernel = number_in(rest);
  const long ticks = ::sysconf(_SC_CLK_TCK);
  if (!user || !kernel || ticks <= 0) return std::nullopt;
  return (*user + *kernel) * (second_ns / static_cast<std::uint64_t>(ticks));
}

/// Returns the numbers of a task in each pid namespace, from that of /proc to its own.
std::vector<std::uint64_t> namespace_numbers_in(std::string_view status) {
  std::string_view rest = line_after(status, "NSpid:");
  std::vector<std::uint64_t> numbers;
  while (const auto number = number_in(rest)) {
    numbers.push_back(*number);
    const std::size_t digit = rest.find_first_of("0123456789");
    rest.remove_prefix(std::min(rest.find_first_not_of("0123456789", digit), rest.size()));
  }
  return numbers;
}

std::string instead_of(const char* name, std::uint64_t is, std::uint64_t wanted) {
  return std::string(name) + ' ' + std::to_string(is) + " instead of " + std::to_string(wanted);
}

bool has_priority(std::uint32_t policy) noexcept {
  return policy == SCHED_FIFO || policy == SCHED_RR;
}

std::string times_words(std::uint64_t runtime_ns, std::uint64_t deadline_ns,
                        std::uint64_t period_ns) {
  return time_for_people(runtime_ns) + '/' + time_for_people(deadline_ns) + '/' +
         time_for_people(period_ns);
}

using Groups = std::span<const CallbackGroup>;

/// Returns the groups with this key; they are sorted by it.
template <class KeyOf>
Groups groups_with(Groups groups, std::uint64_t key, KeyOf key_of) {
  const auto begin = std::partition_point(
      groups.begin(), groups.end(), [&](const CallbackGroup& it) { return key_of(it) < key; });
  const auto end = std::partition_point(begin, groups.end(),
                                        [&](const CallbackGroup& it) { return key_of(it) == key; });
  return {begin, end};
}

/// Chooses the groups of a thread. `groups`: all of its process.
void add_groups(CallbackThread& thread, Groups groups, std::size_t shown_max) {
  for (const std::uint64_t executor : thread.executors) {
    const Groups some = groups_with(
        groups, executor, [](const CallbackGroup& group) { return group.facts.executor; });
    thread.group_count += some.size();
    const std::size_t free = shown_max - thread.groups.size();
    for (const CallbackGroup& group : some.first(std::min(some.size(), free)))
      thread.groups.push_back(&group);
  }
}

}  // namespace

ProcessThreads::ProcessThreads(const wire::DumpProcess& process) {
  if (process.state == wire::ProcessState::dead || !is_visible(process)) return;
  // Thread numbers are of the pid namespace of /proc, system calls take those of the caller's.
  std::error_code unknown;
  if (std::filesystem::read_symlink("/proc/self", unknown) != std::to_string(::getpid())) return;
  pid_ = static_cast<pid_t>(process.pid);
  is_translated_ = namespace_numbers_in(contents_of(of_process(pid_, "status"))).size() > 1;
  if (!is_translated_) return;
  const std::string tasks = of_process(pid_, "task");
  for (std::filesystem::directory_iterator task(tasks, unknown), end; !unknown && task != end;
       task.increment(unknown)) {
    const auto numbers = namespace_numbers_in(contents_of(task->path().string() + "/status"));
    if (!numbers.empty())
      here_.emplace(static_cast<std::uint32_t>(numbers.back()),
                    static_cast<pid_t>(numbers.front()));
  }
}

std::optional<KernelThread> ProcessThreads::find(std::uint32_t thread) const {
  if (pid_ == 0) return std::nullopt;
  pid_t here = static_cast<pid_t>(thread);
  if (is_translated_) {
    const auto found = here_.find(thread);
    if (found == here_.end()) return std::nullopt;
    here = found->second;
  }
  const UniqueFd directory(::open((of_process(pid_, "task/") + std::to_string(here)).c_str(),
                                  O_PATH | O_DIRECTORY | O_CLOEXEC));
  if (!directory) return std::nullopt;
  SchedulingAttributes attributes{};
  KernelMask mask{};
  if (::syscall(SYS_sched_getattr, here, &attributes, sizeof attributes, 0) != 0 ||
      ::syscall(SYS_sched_getaffinity, here, sizeof mask, mask.data()) < 0)
    return std::nullopt;
  // Readable only while this thread lives: until here nothing else had its number.
  const auto cpu_time_ns = cpu_time_of(directory.get());
  if (!cpu_time_ns) return std::nullopt;
  return KernelThread{attributes.policy,
                      attributes.priority,
                      attributes.nice,
                      attributes.runtime_ns,
                      attributes.deadline_ns,
                      attributes.period_ns,
                      (attributes.flags & flag_reset_on_fork) != 0,
                      numbers_in(mask),
                      *cpu_time_ns};
}

std::vector<CallbackThread> threads_of(const System& system, const Arguments& arguments) {
  std::vector<CallbackThread> threads;
  const auto shown = processes_of(system, arguments);
  const std::set<const Process*> processes(shown.begin(), shown.end());
  for (const ThreadFacts& thread : system.callback_threads) {
    const Process& process = system.processes.at(thread.facts.client);  // checked when it came
    if (processes.contains(&process))
      threads.push_back({&process, &thread.facts, thread.executors, {}, 0, {}});
  }
  if (threads.empty()) return threads;
  const std::size_t shown_max = std::max<std::size_t>(shown_of_threads_max / threads.size(), 1);
  std::optional<ProcessThreads> kernel;
  Groups groups;  // of the process
  const Process* last = nullptr;
  for (CallbackThread& thread : threads) {
    if (thread.process != last) {
      kernel.emplace(thread.process->facts);
      groups = groups_with(system.callback_groups, thread.facts->client,
                           [](const CallbackGroup& group) { return group.facts.client; });
    }
    last = thread.process;
    add_groups(thread, groups, shown_max);
    thread.executors = thread.executors.first(std::min(thread.executors.size(), shown_max));
    thread.kernel = kernel->find(thread.facts->thread);
  }
  return threads;
}

std::string policy_word(std::uint32_t policy) {
  // 4 is reserved; sched_ext (7) is newer than the C library.
  constexpr const char* words[] = {"other", "fifo", "rr",       "batch",
                                   nullptr, "idle", "deadline", "ext"};
  if (policy < std::size(words) && words[policy] != nullptr) return words[policy];
  return "policy " + std::to_string(policy);
}

std::string priority_words(const KernelThread& thread) {
  if (has_priority(thread.policy)) return std::to_string(thread.priority);
  if (thread.policy == SCHED_DEADLINE)
    return times_words(thread.runtime_ns, thread.deadline_ns, thread.period_ns);
  return "nice " + std::to_string(thread.nice);
}

std::string cpu_list(std::span<const std::uint32_t> cpus) {
  std::string text;
  for (std::size_t i = 0; i < cpus.size();) {
    std::size_t last = i;
    while (last + 1 < cpus.size() && cpus[last + 1] == cpus[last] + 1) ++last;
    text += (text.empty() ? "" : ",") + std::to_string(cpus[i]);
    if (last != i) text += '-' + std::to_string(cpus[last]);
    i = last + 1;
  }
  return text;
}

std::vector<std::uint32_t> cpus_of(const wire::ThreadScheduling& scheduling) {
  return scheduling.sets_cpus == 0 ? std::vector<std::uint32_t>() : numbers_in(scheduling.cpus);
}

Difference difference_of(const wire::ThreadScheduling& wanted, const KernelThread& is) {
  std::string words;
  const auto add = [&](const std::string& text) { words += (words.empty() ? "" : ", ") + text; };
  if (wanted.sets_policy != 0 && wanted.policy != is.policy) {
    add("policy " + policy_word(is.policy) + " instead of " + policy_word(wanted.policy));
  } else if (wanted.sets_policy != 0 && has_priority(is.policy) && wanted.priority != is.priority) {
    add(instead_of("priority", is.priority, wanted.priority));
  } else if (wanted.sets_policy != 0 && is.policy == SCHED_DEADLINE) {
    // A period of 0 is the deadline.
    const std::uint64_t period_ns = wanted.period_ns == 0 ? wanted.deadline_ns : wanted.period_ns;
    if (std::tie(is.runtime_ns, is.deadline_ns, is.period_ns) !=
        std::tie(wanted.runtime_ns, wanted.deadline_ns, period_ns))
      add("times " + times_words(is.runtime_ns, is.deadline_ns, is.period_ns) + " instead of " +
          times_words(wanted.runtime_ns, wanted.deadline_ns, period_ns));
  }
  // The kernel tells no nice value of a real-time thread, and sets none of an idle one.
  if (wanted.sets_nice != 0 && (is.policy == SCHED_OTHER || is.policy == SCHED_BATCH) &&
      wanted.nice != is.nice)
    add("nice " + std::to_string(is.nice) + " instead of " + std::to_string(wanted.nice));
  const bool is_scheduled = words.empty();
  if (wanted.sets_cpus == 0) return {words};
  const auto cpus = cpus_of(wanted);
  if (cpus == is.cpus) return {words};
  add("processors " + cpu_list(is.cpus) + " instead of " + cpu_list(cpus));
  return {words,
          is_scheduled && std::includes(cpus.begin(), cpus.end(), is.cpus.begin(), is.cpus.end())};
}

const char* word_of(wire::ThreadSetting setting) noexcept {
  switch (setting) {
    case wire::ThreadSetting::no_rule:
      return "no_rule";
    case wire::ThreadSetting::due:
      return "due";
    case wire::ThreadSetting::applied:
      return "applied";
    case wire::ThreadSetting::not_allowed:
      return "not_allowed";
    case wire::ThreadSetting::refused:
      return "refused";
    case wire::ThreadSetting::not_found:
      return "not_found";
  }
  return "?";
}

const char* word_of(wire::ThreadCall call) noexcept {
  switch (call) {
    case wire::ThreadCall::none:
      return nullptr;
    case wire::ThreadCall::sched_setattr:
      return "sched_setattr";
    case wire::ThreadCall::sched_setaffinity:
      return "sched_setaffinity";
  }
  return nullptr;
}

std::string rule_words(const wire::DumpCallbackThread& thread) {
  return "rule at line " + std::to_string(thread.rule);
}

}  // namespace agnocast::ctl
