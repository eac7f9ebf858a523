// SPDX-License-Identifier: Apache-2.0
//
// heap list, heap info: the heap windows of processes and their use.

#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/commands/objects.hpp>
#include <ctl/snapshot/numbers.hpp>
#include <ctl/snapshot/select.hpp>
#include <ctl/snapshot/system.hpp>

#include <string>
#include <vector>

namespace agnocast::ctl {
namespace {

Outcome<void> print_heaps(const System& system, const std::vector<const Process*>& processes,
                          const char* schema, const Arguments& arguments, Console& console) {
  Object list = Object::array();
  Table table({"PID", "NAME", "WINDOW", "BASE", "LENGTH", "IN USE", "MESSAGES"});
  for (const Process* const process : processes) {
    const auto numbers = numbers_of_windows(system, *process);
    for (Object& window : windows_object(system, *process)) list.push_back(std::move(window));
    for (std::uint32_t w = 0; w < process->facts.window_count; ++w) {
      const bool known = w < numbers.size();
      table.add({std::to_string(process->facts.pid), escaped(process->name), std::to_string(w),
                 hexadecimal(process->facts.window[w].base),
                 bytes_for_people(process->facts.window[w].bytes),
                 known ? bytes_for_people(numbers[w].used_bytes) : "unknown",
                 known ? std::to_string(numbers[w].messages) : "unknown"});
    }
  }
  if (arguments.json == Json::no) {
    table.print(console);
  } else {
    console.object({{"schema", schema},
                    {"arena_base_address", hexadecimal(system.daemon.arena_base)},
                    {"arena_bytes", system.daemon.arena_bytes},
                    {"window_count", list.size()},
                    {"windows", list}},
                   arguments.json);
  }
  return {};
}

}  // namespace

Object windows_object(const System& system, const Process& process) {
  Object list = Object::array();
  const auto numbers = numbers_of_windows(system, process);
  for (std::uint32_t w = 0; w < process.facts.window_count; ++w) {
    const bool known = w < numbers.size();
    list.push_back({{"pid", process.facts.pid},
                    {"name", process.name},
                    {"window", w},
                    {"base_address", hexadecimal(process.facts.window[w].base)},
                    {"length_bytes", process.facts.window[w].bytes},
                    {"used_bytes", known ? Object(numbers[w].used_bytes) : Object(nullptr)},
                    {"messages", known ? Object(numbers[w].messages) : Object(nullptr)}});
  }
  return list;
}

Outcome<void> list_heaps(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  return print_heaps(look->system, processes_of(look->system, arguments), "agnocast.heap-list/1",
                     arguments, console);
}

Outcome<void> show_heap(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  const auto processes = find_processes(look->system, arguments.subject(0));
  if (!processes) return tl::unexpected(processes.error());
  return print_heaps(look->system, *processes, "agnocast.heap-info/1", arguments, console);
}

}  // namespace agnocast::ctl
