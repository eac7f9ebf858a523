// SPDX-License-Identifier: Apache-2.0
//
// heap list: the windows of addresses that processes have, and how far they are in use.

#include <base/text.hpp>
#include <ctl/commands.hpp>
#include <ctl/numbers.hpp>
#include <ctl/system.hpp>

#include <string>

namespace agnocast::ctl {

Outcome<void> list_heaps(const Arguments& arguments, Console& console) {
  const auto look = look_at(arguments.socket);
  if (!look) return tl::unexpected(look.error());
  Object list = Object::array();
  Table table({"PID", "NAME", "WINDOW", "BASE", "LENGTH", "IN USE", "MESSAGES"});
  for (const auto& [index, process] : look->system.processes) {
    const wire::DumpProcess& facts = process.facts;
    if (!arguments.all_domains && facts.domain != arguments.domain) continue;
    const auto numbers = numbers_of_windows(look->system, process);
    for (std::uint32_t w = 0; w < facts.window_count; ++w) {
      const bool known = w < numbers.size();
      list.push_back({{"pid", facts.pid},
                      {"name", process.name},
                      {"window", w},
                      {"base_address", hexadecimal(facts.window[w].base)},
                      {"length_bytes", facts.window[w].bytes},
                      {"used_bytes", known ? Object(numbers[w].used_bytes) : Object(nullptr)},
                      {"messages", known ? Object(numbers[w].messages) : Object(nullptr)}});
      table.add({std::to_string(facts.pid), escaped(process.name), std::to_string(w),
                 hexadecimal(facts.window[w].base), bytes_for_people(facts.window[w].bytes),
                 known ? bytes_for_people(numbers[w].used_bytes) : "unknown",
                 known ? std::to_string(numbers[w].messages) : "unknown"});
    }
  }
  if (arguments.json == Json::no) {
    table.print(console);
  } else {
    const wire::DumpDaemon& daemon = look->system.daemon;
    console.object({{"schema", "agnocast.heap-list/1"},
                    {"arena_base_address", hexadecimal(daemon.arena_base)},
                    {"arena_bytes", daemon.arena_bytes},
                    {"window_count", list.size()},
                    {"windows", list}},
                   arguments.json);
  }
  return {};
}

}  // namespace agnocast::ctl
