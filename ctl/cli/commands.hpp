// SPDX-License-Identifier: Apache-2.0
//
// Commands: one row of command_table.cpp is one command, with the function that carries it out.
// Help, manual and completion are made from the rows.
#pragma once

#include <ctl/cli/arguments.hpp>
#include <ctl/cli/console.hpp>
#include <ctl/cli/option.hpp>
#include <ctl/cli/problem.hpp>

#include <span>
#include <string_view>

namespace agnocast::ctl {

struct Command {
  std::string_view noun;
  std::string_view verb;  // empty: the noun is the whole command
  std::string_view summary;
  std::span<const Subject* const> subjects;
  std::span<const Option* const> options;  // besides the common ones
  Outcome<void> (*run)(const Arguments&, Console&);
  std::string_view description;  // sentences, for the manual
  std::string_view examples;     // lines
};

/// All commands, in the order of help and manual.
extern const std::span<const Command> all_commands;

// One function for each command; the table describes them.
Outcome<void> show_status(const Arguments& arguments, Console& console);
Outcome<void> list_topics(const Arguments& arguments, Console& console);
Outcome<void> show_topic(const Arguments& arguments, Console& console);
Outcome<void> echo_topic(const Arguments& arguments, Console& console);
Outcome<void> pub_topic(const Arguments& arguments, Console& console);
Outcome<void> show_delay(const Arguments& arguments, Console& console);
Outcome<void> list_services(const Arguments& arguments, Console& console);
Outcome<void> show_service(const Arguments& arguments, Console& console);
Outcome<void> find_services(const Arguments& arguments, Console& console);
Outcome<void> call_service(const Arguments& arguments, Console& console);
Outcome<void> show_service_type(const Arguments& arguments, Console& console);
Outcome<void> list_processes(const Arguments& arguments, Console& console);
Outcome<void> revoke_process(const Arguments& arguments, Console& console);
Outcome<void> list_threads(const Arguments& arguments, Console& console);
Outcome<void> list_heaps(const Arguments& arguments, Console& console);
Outcome<void> show_journal(const Arguments& arguments, Console& console);
Outcome<void> run_doctor(const Arguments& arguments, Console& console);
Outcome<void> verify_system(const Arguments& arguments, Console& console);
Outcome<void> find_topics(const Arguments& arguments, Console& console);
Outcome<void> show_type(const Arguments& arguments, Console& console);
Outcome<void> measure_rate(const Arguments& arguments, Console& console);
Outcome<void> measure_bandwidth(const Arguments& arguments, Console& console);
Outcome<void> list_nodes(const Arguments& arguments, Console& console);
Outcome<void> show_node(const Arguments& arguments, Console& console);
Outcome<void> show_process(const Arguments& arguments, Console& console);
Outcome<void> show_heap(const Arguments& arguments, Console& console);
Outcome<void> list_messages(const Arguments& arguments, Console& console);
Outcome<void> write_metrics(const Arguments& arguments, Console& console);
Outcome<void> show_top(const Arguments& arguments, Console& console);
Outcome<void> monitor_system(const Arguments& arguments, Console& console);
Outcome<void> dump_all(const Arguments& arguments, Console& console);
Outcome<void> draw_graph(const Arguments& arguments, Console& console);
Outcome<void> explain_code(const Arguments& arguments, Console& console);
Outcome<void> show_access(const Arguments& arguments, Console& console);
Outcome<void> list_bridges(const Arguments& arguments, Console& console);
Outcome<void> show_bridged(const Arguments& arguments, Console& console);
Outcome<void> show_log_level(const Arguments& arguments, Console& console);

}  // namespace agnocast::ctl
