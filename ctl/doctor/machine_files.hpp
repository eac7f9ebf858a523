// SPDX-License-Identifier: Apache-2.0
//
// Files of this machine as the doctor reads them: /proc of a process, settings, directories. What
// cannot be read is empty.
#pragma once

#include <ctl/snapshot/proc_files.hpp>

#include <dirent.h>
#include <sys/types.h>

#include <optional>
#include <string>
#include <vector>

namespace agnocast::ctl {

std::string target_of(const std::string& link);
std::vector<std::string> split(const std::string& text, char mark);
std::string command_name(pid_t pid);
/// Returns a variable of the environment; none: it is unset or empty.
std::optional<std::string> variable(const char* name);
/// Returns the path that a process was given with --config; empty: none.
std::string named_configuration_of(pid_t pid);
/// Returns what a program prints to stderr when it fails; empty: it succeeds or does not exist.
std::string complaint_of(std::vector<std::string> words);

/// Calls `use` with the name of each entry that is not hidden.
template <class Use>
void for_each_entry(const std::string& directory, Use use) {
  DIR* const entries = ::opendir(directory.c_str());
  if (entries == nullptr) return;
  while (const dirent* const entry = ::readdir(entries)) {
    if (entry->d_name[0] != '.') use(std::string(entry->d_name));
  }
  ::closedir(entries);
}

}  // namespace agnocast::ctl
