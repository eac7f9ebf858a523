// SPDX-License-Identifier: Apache-2.0
//
// Objects: things as JSON and as lines, for the several commands that print them (such as info and
// dump).
#pragma once

#include <ctl/cli/console.hpp>
#include <ctl/snapshot/journal.hpp>
#include <ctl/snapshot/system.hpp>

#include <string>

namespace agnocast::ctl {

/// status.cpp; includes its schema.
Object status_object(const System& system, const std::string& socket);
/// status.cpp: what one user has or may have; unlimited is null.
Object share_object(const wire::UserShare& share);
/// topics.cpp
Object topic_object(const System& system, const Topic& topic);
/// processes.cpp
Object process_object(const System& system, const Process& process);
Object refusal_object(const wire::DumpRefusal& refusal);
/// threads.cpp: of the domain or of all; the system must be a look with LookOptions::threads.
Object threads_object(const System& system, const Arguments& arguments);
/// heaps.cpp
Object windows_object(const System& system, const Process& process);
/// messages.cpp
Object messages_object(const System& system, const Topic& topic, std::uint64_t now_ns);

/// journal.cpp: a record as a whole line, "12:01:33.120 #4711 publisher 3 of /points (lidar, pid
/// 812): ended …", and for programs.
std::string line_of(const wire::JournalRecord& record, const Journal& journal);
Object record_object(const wire::JournalRecord& record, const Journal& journal);
/// journal.cpp: the current time, "12:01:33.120" and "2026-01-31T12:01:33.120Z".
std::string now_for_people();
std::string now_for_programs();

/// log_level.cpp: "info".
const char* level_word(std::uint64_t level) noexcept;

}  // namespace agnocast::ctl
