// SPDX-License-Identifier: Apache-2.0
//
// Doctor: checks as data. A check looks at facts that were collected before (doctor_facts.hpp), so it is
// pure; what it finds says what is wrong, and its row says why that is so and which command mends it.
//
// A remedy is one line for a shell. Words in capitals in it are filled from the finding (PID, TOPIC), or are
// commands that all remedies share:
//
//   START    starts the daemon
//   ANEW     stops the daemon, which gives up what it keeps, and starts it
//   RELOAD   lets the daemon read its configuration and its program again; members stay members
//   FILE     the daemon's configuration
//
// docs/doctor.md has the table as people read it.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::ctl {

struct Facts;

/// Values of the words of a remedy, ready for a shell.
using Fill = std::map<std::string, std::string, std::less<>>;

struct Ailment {
  std::string what;  // where, with names; escaped
  Fill words = {};
  std::string cause = {};  // in place of the check's, when more is known
};

struct Check {
  enum class Severity : std::uint8_t { failed, warning };
  enum class Needs : std::uint8_t { nothing, daemon };
  std::string_view id;
  std::string_view title;  // what is so when all is well
  Severity severity;
  Needs needs;
  std::string_view cause;
  std::string_view remedy;
  std::vector<Ailment> (*find)(const Facts&);
};

/// doctor_door.cpp: this shell, and the way to the daemon.
extern const std::span<const Check> door_checks;
/// doctor_host.cpp: the daemon itself, its limits, and the host.
extern const std::span<const Check> host_checks;
/// doctor_members.cpp: the processes, and what passes between them.
extern const std::span<const Check> member_checks;
/// doctor_bridge.cpp: the bridges to DDS.
extern const std::span<const Check> bridge_checks;
/// All of them, in the order in which they are looked at.
std::vector<const Check*> all_checks();

/// The remedy with its words filled in; a word that nobody fills stays.
std::string filled(std::string_view remedy, const Fill& words, const Fill& common);
/// One word for a shell, whatever it holds.
std::string shell_word(std::string_view text);

}  // namespace agnocast::ctl
