// SPDX-License-Identifier: Apache-2.0
//
// Commands: what agnocast-ctl can do. One row in main.cpp's table is one command; a function that
// looks at the system and prints is the rest of it.
#pragma once

#include <ctl/arguments.hpp>
#include <ctl/console.hpp>
#include <ctl/problem.hpp>

#include <cstdint>
#include <string_view>

namespace agnocast::ctl {

/// Options that a command takes besides those that all take.
enum Takes : std::uint32_t {
  nothing = 0,
  a_name = 1 << 0,
  domain = 1 << 1,
  domains = 1 << 6 | domain,  // one or all
  types = 1 << 2,
  count = 1 << 3,
  verbose = 1 << 4,
  hidden = 1 << 5,
  records = 1 << 7,  // which records of the journal
  a_process = 1 << 8,
};

struct Command {
  std::string_view noun;
  std::string_view verb;  // empty: the noun is the whole command
  std::string_view summary;
  std::uint32_t takes;
  Outcome<void> (*run)(const Arguments&, Console&);
  std::string_view examples;  // lines
};

Outcome<void> show_status(const Arguments& arguments, Console& console);
Outcome<void> list_topics(const Arguments& arguments, Console& console);
Outcome<void> show_topic(const Arguments& arguments, Console& console);
Outcome<void> list_processes(const Arguments& arguments, Console& console);
Outcome<void> revoke_process(const Arguments& arguments, Console& console);
Outcome<void> list_heaps(const Arguments& arguments, Console& console);
Outcome<void> show_journal(const Arguments& arguments, Console& console);
Outcome<void> verify_system(const Arguments& arguments, Console& console);

}  // namespace agnocast::ctl
