// SPDX-License-Identifier: Apache-2.0
//
// process list: the processes with a session, their state, and the memory of others that they
// keep. process revoke: ends the session of a running process.

#include <agnocast/error.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <ctl/snapshot/refusals.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/system.hpp>

#include <bit>
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
          {"wait_set_count", std::popcount(facts.wait_sets)},
          {"window_count", facts.window_count},
          {"window_bytes", heap_bytes_of(process)},
          {"unread_messages", kept.unread},
          {"held_messages", kept.held},
          {"lost_messages", kept.lost},
          {"kept_slots", kept.slots},
          {"kept_object_bytes", kept.object_bytes},
          {"blocked_bytes", facts.blocked_bytes},
          {"blocked_by", process.blocked_by},
          {"threads_left_out", facts.threads_left_out}};
}

}  // namespace

Object process_object(const System& system, const Process& process) {
  return object_of(process, numbers_of_kept(system, process));
}

Outcome<void> show_process(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const System& system = look->system;
  const auto found = find_processes(system, arguments.subject(0));
  if (!found) return tl::unexpected(found.error());
  Object list = Object::array();
  for (const Process* const process : *found) {
    Object object = process_object(system, *process);
    object["windows"] = windows_object(system, *process);
    object["publishers"] = Object::array();
    object["subscriptions"] = Object::array();
    object["refusals"] = Object::array();
    std::string publishers, subscriptions;
    for (const std::uint32_t index : process->topics) {
      const Topic& topic = system.topics.at(index);
      for (const auto* endpoints : {&topic.publishers, &topic.subscriptions}) {
        for (const Endpoint& endpoint : *endpoints) {
          if (system.process_of(endpoint) != process) continue;
          object[endpoint.is_publisher() ? "publishers" : "subscriptions"].push_back(
              {{"topic", topic.name},
               {"type", topic.type},
               {"node_name", endpoint.node_name},
               {"node_namespace", endpoint.node_namespace},
               {"generation", endpoint.facts.generation}});
          (endpoint.is_publisher() ? publishers : subscriptions) +=
              "\n    " + escaped(topic.name) + ": " + escaped(topic.type);
        }
      }
    }
    std::string refusals;
    for (const wire::DumpRefusal& refusal : system.refusals) {
      if (refusal.pid != process->facts.pid || refusal.uid != process->facts.uid) continue;
      object["refusals"].push_back(refusal_object(refusal));
      refusals += "\n    " + refusal_words(refusal);
    }
    list.push_back(object);
    if (arguments.json != Json::no) continue;
    const KeptNumbers kept = numbers_of_kept(system, *process);
    const wire::DumpProcess& facts = process->facts;
    console.line(escaped(process->name) + " (pid " + std::to_string(facts.pid) + ", uid " +
                 std::to_string(facts.uid) + ", gid " + std::to_string(facts.gid) + "), client " +
                 client_of(facts) + ", domain " + std::to_string(facts.domain));
    console.line(std::string("  State: ") + state_of(facts) + " for " +
                 duration_for_people(facts.age_ns));
    console.line("  Heap: " + counted(facts.window_count, "window") + " of " +
                 bytes_for_people(heap_bytes_of(*process)));
    console.line("  Keeps of others: " + counted(kept.slots, "slot") + ", " +
                 std::to_string(kept.unread) + " unread, " + std::to_string(kept.held) + " held; " +
                 std::to_string(kept.lost) + " lost");
    if (facts.blocked_bytes != 0)
      console.line("  Blocked: " + bytes_for_people(facts.blocked_bytes) + " of the arena, by " +
                   escaped(process->blocked_by));
    if (facts.threads_left_out != 0)
      console.line("  Not known to the daemon: " + counted(facts.threads_left_out,
                                                           "callback group or thread",
                                                           "callback groups and threads"));
    console.line("  Publishers:" + publishers);
    console.line("  Subscribers:" + subscriptions);
    if (!refusals.empty()) console.line("  Refused recently:" + refusals);
  }
  if (arguments.json != Json::no)
    console.object({{"schema", "agnocast.process-info/1"},
                    {"process_count", list.size()},
                    {"processes", list}},
                   arguments.json);
  return {};
}

Object refusal_object(const wire::DumpRefusal& refusal) {
  const std::string topic = text_of(refusal.topic), name = text_of(refusal.process_name);
  return {{"code", word_of(static_cast<Errc>(refusal.code))},
          {"uid", refusal.uid},
          {"pid", refusal.pid},
          {"process_name", name.empty() ? Object(nullptr) : Object(name)},
          {"topic", topic.empty() ? Object(nullptr) : Object(topic)},
          {"kind", refusal.kind == wire::Kind::publisher      ? Object("publisher")
                   : refusal.kind == wire::Kind::subscription ? Object("subscription")
                                                              : Object(nullptr)},
          {"domain", refusal.domain},
          {"why", text_of(refusal.why)},
          {"age_ns", refusal.age_ns},
          {"times", refusal.times}};
}

Outcome<void> list_processes(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  Object list = Object::array();
  Table table({"PID", "UID", "NAME", "DOMAIN", "STATE", "AGE", "PUBLISHERS", "SUBSCRIPTIONS",
               "UNREAD", "HELD", "KEEPS", "WAIT SETS", "WINDOWS", "CLIENT"});
  for (const Process* const each : processes_of(look->system, arguments)) {
    const Process& process = *each;
    const wire::DumpProcess& facts = process.facts;
    const KeptNumbers kept = numbers_of_kept(look->system, process);
    if (arguments.json != Json::no) {
      list.push_back(object_of(process, kept));
      continue;
    }
    table.add(
        {std::to_string(facts.pid), std::to_string(facts.uid), escaped(process.name),
         std::to_string(facts.domain), state_of(facts), duration_for_people(facts.age_ns),
         std::to_string(process.publisher_count), std::to_string(process.subscription_count),
         std::to_string(kept.unread), std::to_string(kept.held), counted(kept.slots, "slot"),
         std::to_string(std::popcount(facts.wait_sets)),
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

// Takes no name: several processes may share it, and a revocation cannot be undone.
Outcome<std::vector<const Process*>> find_connected(const System& system, const std::string& name) {
  if (name.find_first_not_of("0123456789.") != std::string::npos)
    return problem(Status::wrong_usage, escaped(name), "this is neither a pid nor INDEX.GENERATION",
                   "agnocast-ctl process list --all-domains");
  auto found = find_processes(system, name);
  if (!found) return found;
  std::erase_if(*found, [](const Process* process) {
    return process->facts.state != wire::ProcessState::connected &&
           process->facts.state != wire::ProcessState::orphaned;
  });
  if (!found->empty()) return found;
  return problem(Status::no_such_thing, escaped(name), "it has no session any more",
                 "agnocast-ctl process list --all-domains");
}

}  // namespace

Outcome<void> revoke_process(const Arguments& arguments, Console& console) {
  auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const auto found = find_connected(look->system, arguments.subject(0));
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
                   (was_stopped ? "; it is stopped and will be notified when it continues" : ""));
  }
  if (arguments.json != Json::no)
    console.object({{"schema", "agnocast.process-revoke/1"},
                    {"process_count", list.size()},
                    {"processes", list}},
                   arguments.json);
  return {};
}

}  // namespace agnocast::ctl
