// SPDX-License-Identifier: Apache-2.0
//
// process list: who takes part, and how the daemon stands to them.

#include <base/text.hpp>
#include <ctl/commands.hpp>
#include <ctl/system.hpp>

#include <bit>
#include <string>

namespace agnocast::ctl {
namespace {

const char* word_of(wire::ProcessState state) noexcept {
  switch (state) {
    case wire::ProcessState::connected:
      return "alive";
    case wire::ProcessState::orphaned:
      return "orphaned";
    case wire::ProcessState::dead:
      return "dead";
  }
  return "?";
}

std::uint64_t heap_bytes_of(const Process& process) noexcept {
  std::uint64_t sum = 0;
  for (std::uint32_t w = 0; w < process.facts.window_count; ++w)
    sum += process.facts.window[w].bytes;
  return sum;
}

Object object_of(const Process& process) {
  const wire::DumpProcess& facts = process.facts;
  return {{"pid", facts.pid},
          {"uid", facts.uid},
          {"gid", facts.gid},
          {"name", process.name},
          {"domain", facts.domain},
          {"state", word_of(facts.state)},
          {"age_ns", facts.age_ns},
          {"client_index", facts.client},
          {"client_generation", facts.generation},
          {"publisher_count", process.publisher_count},
          {"subscription_count", process.subscription_count},
          {"executor_count", std::popcount(facts.executors)},
          {"window_count", facts.window_count},
          {"window_bytes", heap_bytes_of(process)},
          {"blocked_bytes", facts.blocked_bytes},
          {"blocked_by", process.blocked_by}};
}

}  // namespace

Outcome<void> list_processes(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  Object list = Object::array();
  Table table({"PID", "UID", "NAME", "DOMAIN", "STATE", "SINCE", "PUBLISHERS", "SUBSCRIPTIONS",
               "EXECUTORS", "WINDOWS"});
  for (const auto& [index, process] : look->system.processes) {
    const wire::DumpProcess& facts = process.facts;
    if (!arguments.all_domains && facts.domain != arguments.domain) continue;
    list.push_back(object_of(process));
    table.add({std::to_string(facts.pid), std::to_string(facts.uid), escaped(process.name),
               std::to_string(facts.domain), word_of(facts.state),
               duration_for_people(facts.age_ns), std::to_string(process.publisher_count),
               std::to_string(process.subscription_count),
               std::to_string(std::popcount(facts.executors)),
               std::to_string(facts.window_count) + " (" +
                   bytes_for_people(heap_bytes_of(process)) + ")"});
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

}  // namespace agnocast::ctl
