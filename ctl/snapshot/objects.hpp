// SPDX-License-Identifier: Apache-2.0
//
// Objects: things as JSON, for the several commands that print them (such as info and dump).
#pragma once

#include <ctl/cli/console.hpp>
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
std::string refusal_words(const wire::DumpRefusal& refusal);
/// threads.cpp: of the domain or of all; the system must be a look with LookOptions::threads.
Object threads_object(const System& system, const Arguments& arguments);
/// heaps.cpp
Object windows_object(const System& system, const Process& process);
/// messages.cpp
Object messages_object(const System& system, const Topic& topic, std::uint64_t now_ns);

/// log_level.cpp: "info".
const char* level_word(std::uint64_t level) noexcept;

}  // namespace agnocast::ctl
