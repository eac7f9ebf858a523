// SPDX-License-Identifier: Apache-2.0
//
// Doctor: checks as data. A check is a pure function of the facts in doctor_facts.hpp. Its finding
// says what is wrong; its row gives the cause and the command that fixes it.
//
// A remedy is one line for a shell. Words in capitals in it are filled in from the finding (PID,
// TOPIC), or are commands that all remedies share:
//
//   START    starts the daemon
//   ANEW     stops the daemon, which discards its stored state, and starts it
//   RELOAD   lets the daemon reload its configuration and its program; sessions continue
//   FILE     the daemon's configuration
//
// docs/doctor.md shows the table.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {

struct Facts;

/// Values for the words of a remedy, quoted for a shell.
using Fill = std::map<std::string, std::string, std::less<>>;

struct Ailment {
  std::string what;  // what is wrong and where; escaped
  Fill words = {};
  std::string cause = {};  // replaces the check's when more is known
};

struct Check {
  enum class Severity : std::uint8_t { failed, warning };
  enum class Needs : std::uint8_t { nothing, daemon };
  std::string_view id;
  std::string_view title;  // what is true when all is well
  Severity severity;
  Needs needs;
  std::string_view cause;
  std::string_view remedy;
  std::vector<Ailment> (*find)(const Facts&);
};

/// doctor_door.cpp: this shell, and the path to the daemon.
extern const std::span<const Check> door_checks;
/// doctor_host.cpp: the daemon itself, its limits, and the host.
extern const std::span<const Check> host_checks;
/// doctor_processes.cpp: the processes, and the messages between them.
extern const std::span<const Check> process_checks;
/// doctor_threads.cpp: the scheduling of the threads that run callbacks.
extern const std::span<const Check> thread_checks;
/// doctor_bridge.cpp: the bridges to DDS.
extern const std::span<const Check> bridge_checks;
/// Returns all checks, in the order in which they run.
std::vector<const Check*> all_checks();

/// Returns the remedy with its words filled in; a word without a value stays.
std::string filled(std::string_view remedy, const Fill& words, const Fill& common);
/// Returns `text` quoted as one word for a shell.
std::string shell_word(std::string_view text);

}  // namespace agnocast::ctl
