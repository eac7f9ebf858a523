// SPDX-License-Identifier: Apache-2.0
//
// thread list: the threads that run callbacks, how the kernel schedules them, and the rule of the
// daemon's configuration behind it.

#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/system.hpp>
#include <ctl/snapshot/threads.hpp>

#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <set>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

namespace agnocast::ctl {
namespace {

std::string node_name_of(const CallbackGroup& group) {
  return (group.node_namespace == "/" ? "" : group.node_namespace) + '/' + group.node_name;
}

// --- JSON

Object numbers_or_null(bool is_set, const std::vector<std::uint32_t>& numbers) {
  return is_set ? Object(numbers) : Object(nullptr);
}

Object kernel_object(const KernelThread& kernel) {
  return {{"policy", policy_word(kernel.policy)},
          {"priority", kernel.priority},
          {"nice", kernel.nice},
          {"runtime_ns", kernel.runtime_ns},
          {"deadline_ns", kernel.deadline_ns},
          {"period_ns", kernel.period_ns},
          {"reset_on_fork", kernel.reset_on_fork},
          {"cpus", kernel.cpus}};
}

Object rule_object(const wire::DumpCallbackThread& thread) {
  const wire::ThreadScheduling& wanted = thread.scheduling;
  const auto number = [](bool is_set, auto value) {
    return is_set ? Object(value) : Object(nullptr);
  };
  const bool has_policy = wanted.sets_policy != 0;
  const bool has_times = has_policy && wanted.policy == SCHED_DEADLINE;
  const bool is_refused = thread.setting == wire::ThreadSetting::refused;
  const char* const call = word_of(thread.call);
  return {{"line", thread.rule},
          {"state", word_of(thread.setting)},
          {"call", number(is_refused && call != nullptr, call == nullptr ? "" : call)},
          {"errno", number(is_refused, thread.os_errno)},
          {"scheduling",
           {{"policy", number(has_policy, policy_word(wanted.policy))},
            {"priority", number(has_policy, wanted.priority)},
            {"nice", number(wanted.sets_nice != 0, wanted.nice)},
            {"runtime_ns", number(has_times, wanted.runtime_ns)},
            {"deadline_ns", number(has_times, wanted.deadline_ns)},
            {"period_ns", number(has_times, wanted.period_ns)},
            {"cpus", numbers_or_null(wanted.sets_cpus != 0, cpus_of(wanted))}}}};
}

Object object_of(const CallbackThread& thread) {
  Object groups = Object::array();
  for (const CallbackGroup* const group : thread.groups)
    groups.push_back({{"node_name", group->node_name},
                      {"node_namespace", group->node_namespace},
                      {"group", group->facts.group},
                      {"name", group->name},
                      {"reentrant", group->facts.reentrant != 0}});
  const wire::DumpProcess& process = thread.process->facts;
  const auto& kernel = thread.kernel;
  return {{"pid", process.pid},
          {"tid", thread.facts->thread},
          {"process_name", thread.process->name},
          {"domain", process.domain},
          {"client_index", process.client},
          {"client_generation", process.generation},
          {"executor_count", thread.facts->executor_count},
          {"executors", thread.executors},
          {"group_count", thread.group_count},
          {"groups", groups},
          {"kernel", kernel ? kernel_object(*kernel) : Object(nullptr)},
          {"cpu_time_ns", kernel ? Object(kernel->cpu_time_ns) : Object(nullptr)},
          {"rule", thread.has_rule() ? rule_object(*thread.facts) : Object(nullptr)}};
}

Object objects_of(const std::vector<CallbackThread>& threads) {
  Object list = Object::array();
  for (const CallbackThread& thread : threads) list.push_back(object_of(thread));
  return list;
}

// --- for people

std::string and_more(const std::string& first, std::uint64_t count) {
  return count > 1 ? first + " +" + std::to_string(count - 1) : first;
}

std::string name_or_dash(const CallbackGroup& group) {
  return group.name.empty() ? "-" : escaped(group.name);
}

/// Returns how many nodes the groups have.
std::size_t node_count_of(const CallbackThread& thread) {
  std::set<std::pair<std::string_view, std::string_view>> nodes;
  for (const CallbackGroup* const group : thread.groups)
    nodes.emplace(group->node_namespace, group->node_name);
  return nodes.size();
}

std::string rule_cell(const CallbackThread& thread) {
  if (!thread.has_rule()) return {};
  const wire::DumpCallbackThread& facts = *thread.facts;
  std::string rule = rule_words(facts);
  switch (facts.setting) {
    case wire::ThreadSetting::no_rule:
      return {};
    case wire::ThreadSetting::due:
      return rule + ": due";
    case wire::ThreadSetting::applied:
      return thread.kernel && difference_of(facts.scheduling, *thread.kernel)
                 ? rule + ": changed since"
                 : rule;
    case wire::ThreadSetting::not_allowed:
      return rule + ": not allowed";
    case wire::ThreadSetting::refused:
      return rule +
             ": refused: " + std::generic_category().message(static_cast<int>(facts.os_errno));
    case wire::ThreadSetting::not_found:
      return rule + ": not found";
  }
  return rule;
}

std::vector<std::string> row_of(const CallbackThread& thread, std::size_t online_cpus) {
  std::vector<std::string> row{std::to_string(thread.process->facts.pid),
                               std::to_string(thread.facts->thread), escaped(thread.process->name)};
  if (thread.groups.empty()) {
    row.insert(row.end(), {"-", "-"});
  } else {
    const CallbackGroup& first = *thread.groups.front();
    row.push_back(and_more(escaped(node_name_of(first)), node_count_of(thread)));
    row.push_back(and_more(name_or_dash(first), thread.group_count));
  }
  if (const auto& kernel = thread.kernel) {
    row.push_back(policy_word(kernel->policy));
    row.push_back(priority_words(*kernel));
    row.push_back(kernel->cpus.size() == online_cpus ? "all" : cpu_list(kernel->cpus));
    row.push_back(time_for_people(kernel->cpu_time_ns));
  } else {
    row.insert(row.end(), {"not visible", "-", "-", "-"});
  }
  row.push_back(rule_cell(thread));
  return row;
}

void print_groups(const CallbackThread& thread, Console& console) {
  for (const CallbackGroup* const group : thread.groups)
    console.line("  `- group " + name_or_dash(*group) + " of " + escaped(node_name_of(*group)) +
                 (group->facts.reentrant != 0 ? ", reentrant" : ""));
  if (thread.groups.size() < thread.group_count)
    console.line("  `- and " + std::to_string(thread.group_count - thread.groups.size()) + " more");
}

void print(const std::vector<CallbackThread>& threads, bool is_verbose, Console& console) {
  const auto online = static_cast<std::size_t>(std::max(::sysconf(_SC_NPROCESSORS_ONLN), 1L));
  Table table({"PID", "TID", "PROCESS", "NODE", "GROUP", "POLICY", "PRIORITY", "CPUS", "CPU TIME",
               "SET BY"});
  for (const CallbackThread& thread : threads) table.add(row_of(thread, online));
  if (!is_verbose) {
    table.print(console);
    return;
  }
  const auto lines = table.lines();
  console.line(console.strong(lines.front()));
  for (std::size_t i = 0; i < threads.size(); ++i) {
    console.line(lines[i + 1]);
    print_groups(threads[i], console);
  }
}

std::vector<const Process*> incomplete(const System& system, const Arguments& arguments) {
  auto processes = processes_of(system, arguments);
  std::erase_if(processes,
                [](const Process* process) { return process->facts.threads_left_out == 0; });
  return processes;
}

}  // namespace

Object threads_object(const System& system, const Arguments& arguments) {
  return objects_of(threads_of(system, arguments));
}

Outcome<void> list_threads(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket, {.threads = true});
  if (!look) return tl::unexpected(look.error());
  const auto threads = threads_of(look->system, arguments);
  const auto left_out = incomplete(look->system, arguments);
  if (arguments.json == Json::no) {
    print(threads, arguments.has(options::verbose), console);
    for (const Process* const process : left_out)
      console.line("not known to the daemon: " +
                   counted(process->facts.threads_left_out, "callback group or thread",
                           "callback groups and threads") +
                   " of " + words_of(*process));
    return {};
  }
  Object unknown = Object::array();
  for (const Process* const process : left_out)
    unknown.push_back({{"pid", process->facts.pid},
                       {"process_name", process->name},
                       {"client_index", process->facts.client},
                       {"client_generation", process->facts.generation},
                       {"count", process->facts.threads_left_out}});
  console.object({{"schema", "agnocast.thread-list/1"},
                  {"thread_count", threads.size()},
                  {"threads", objects_of(threads)},
                  {"threads_left_out", unknown}},
                 arguments.json);
  return {};
}

}  // namespace agnocast::ctl
