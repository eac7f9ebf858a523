// SPDX-License-Identifier: Apache-2.0
//
// process list: who takes part, how the daemon stands to them, and what they keep of others' memory.
// process revoke: ends the membership of one that lives.

#include <base/text.hpp>
#include <ctl/commands.hpp>
#include <ctl/numbers.hpp>
#include <ctl/system.hpp>

#include <bit>
#include <charconv>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {
namespace {

const char* state_of(const wire::DumpProcess& process) {
  switch (process.state) {
    case wire::ProcessState::connected:
      return is_stopped(process) ? "stopped" : "alive";
    case wire::ProcessState::orphaned:
      return "orphaned";
    case wire::ProcessState::dead:
      return "dead";
    case wire::ProcessState::revoked:
      return "revoked";
  }
  return "?";
}

std::string client_of(const wire::DumpProcess& process) {
  return std::to_string(process.client) + '.' + std::to_string(process.generation);
}

std::uint64_t heap_bytes_of(const Process& process) noexcept {
  std::uint64_t sum = 0;
  for (std::uint32_t w = 0; w < process.facts.window_count; ++w)
    sum += process.facts.window[w].bytes;
  return sum;
}

Object object_of(const Process& process, const KeptNumbers& kept) {
  const wire::DumpProcess& facts = process.facts;
  return {{"pid", facts.pid},
          {"uid", facts.uid},
          {"gid", facts.gid},
          {"name", process.name},
          {"domain", facts.domain},
          {"state", state_of(facts)},
          {"age_ns", facts.age_ns},
          {"client_index", facts.client},
          {"client_generation", facts.generation},
          {"publisher_count", process.publisher_count},
          {"subscription_count", process.subscription_count},
          {"executor_count", std::popcount(facts.executors)},
          {"window_count", facts.window_count},
          {"window_bytes", heap_bytes_of(process)},
          {"unread_messages", kept.unread},
          {"held_messages", kept.held},
          {"lost_messages", kept.lost},
          {"kept_slots", kept.slots},
          {"kept_object_bytes", kept.object_bytes},
          {"blocked_bytes", facts.blocked_bytes},
          {"blocked_by", process.blocked_by}};
}

}  // namespace

Outcome<void> list_processes(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  Object list = Object::array();
  Table table({"PID", "UID", "NAME", "DOMAIN", "STATE", "SINCE", "PUBLISHERS", "SUBSCRIPTIONS",
               "UNREAD", "HELD", "KEEPS", "EXECUTORS", "WINDOWS", "CLIENT"});
  for (const auto& [index, process] : look->system.processes) {
    const wire::DumpProcess& facts = process.facts;
    if (!arguments.all_domains && facts.domain != arguments.domain) continue;
    const KeptNumbers kept = numbers_of_kept(look->system, process);
    list.push_back(object_of(process, kept));
    table.add(
        {std::to_string(facts.pid), std::to_string(facts.uid), escaped(process.name),
         std::to_string(facts.domain), state_of(facts), duration_for_people(facts.age_ns),
         std::to_string(process.publisher_count), std::to_string(process.subscription_count),
         std::to_string(kept.unread), std::to_string(kept.held), counted(kept.slots, "slot"),
         std::to_string(std::popcount(facts.executors)),
         std::to_string(facts.window_count) + " (" + bytes_for_people(heap_bytes_of(process)) + ")",
         client_of(facts)});
  }
  if (arguments.json == Json::no) {
    table.print(console);
  } else {
    console.object({{"schema", "agnocast.process-list/1"},
                    {"process_count", list.size()},
                    {"processes", list}},
                   arguments.json);
  }
  return {};
}

namespace {

// Every client that a pid has, or the one that INDEX.GENERATION names; of those that are members.
Outcome<std::vector<const Process*>> find_processes(const System& system, const std::string& name) {
  std::uint64_t pid = 0;
  const char* const end = name.data() + name.size();
  const auto parsed = std::from_chars(name.data(), end, pid);
  const bool is_pid = parsed.ec == std::errc() && parsed.ptr == end;
  if (!is_pid && (parsed.ec != std::errc() || *parsed.ptr != '.'))
    return problem(Status::wrong_usage, escaped(name), "this is neither a pid nor INDEX.GENERATION",
                   "agnocast-ctl process list --all-domains");
  std::vector<const Process*> found;
  for (const auto& [index, process] : system.processes) {
    const bool is_member = process.facts.state == wire::ProcessState::connected ||
                           process.facts.state == wire::ProcessState::orphaned;
    // One that the daemon sees without a pid is not found by 0.
    const bool is_meant =
        is_pid ? pid != 0 && process.facts.pid == pid : client_of(process.facts) == name;
    if (is_member && is_meant) found.push_back(&process);
  }
  if (found.empty())
    return problem(Status::no_such_thing, escaped(name), "there is no such process",
                   "agnocast-ctl process list --all-domains");
  return found;
}

}  // namespace

Outcome<void> revoke_process(const Arguments& arguments, Console& console) {
  auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const auto found = find_processes(look->system, arguments.subject(0));
  if (!found) return tl::unexpected(found.error());
  Object list = Object::array();
  for (const Process* const process : *found) {
    const wire::DumpProcess& facts = process->facts;
    const bool was_stopped = is_stopped(facts);
    if (auto revoked = look->observer.revoke(facts); !revoked) return revoked;
    list.push_back({{"pid", facts.pid},
                    {"uid", facts.uid},
                    {"name", process->name},
                    {"client_index", facts.client},
                    {"client_generation", facts.generation},
                    {"was_stopped", was_stopped},
                    {"publisher_count", process->publisher_count},
                    {"subscription_count", process->subscription_count}});
    if (arguments.json == Json::no)
      console.line("revoked: " + escaped(process->name) + " (pid " + std::to_string(facts.pid) +
                   ", uid " + std::to_string(facts.uid) +
                   "): " + counted(process->publisher_count, "publisher") + ", " +
                   counted(process->subscription_count, "subscription") +
                   (was_stopped ? "; it is stopped and will be told when it goes on" : ""));
  }
  if (arguments.json != Json::no)
    console.object({{"schema", "agnocast.process-revoke/1"},
                    {"process_count", list.size()},
                    {"processes", list}},
                   arguments.json);
  return {};
}

}  // namespace agnocast::ctl
