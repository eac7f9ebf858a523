// SPDX-License-Identifier: Apache-2.0
//
// The resources of a process, to check that it has no more than before.
#pragma once

#include <dirent.h>
#include <sys/types.h>

#include <cstddef>
#include <fstream>
#include <string>

namespace agnocast::test {

struct Held {
  std::size_t descriptors = 0, threads = 0;
  // Without pages of regions and windows: they belong to others, and each counts from the first
  // time that the process reads it, which for the board's places is when their turn comes.
  std::size_t anonymous_kib = 0;
};
inline Held held_by(pid_t pid) {
  const std::string directory = "/proc/" + std::to_string(pid);
  const auto entries_in = [&](const char* name) {
    std::size_t count = 0;
    DIR* const open = ::opendir((directory + name).c_str());
    while (open != nullptr && ::readdir(open) != nullptr) ++count;
    if (open != nullptr) ::closedir(open);
    return count;
  };
  Held held{entries_in("/fd"), entries_in("/task"), 0};
  std::ifstream status(directory + "/status");
  for (std::string line; std::getline(status, line);)
    if (line.starts_with("RssAnon:")) held.anonymous_kib = std::stoul(line.substr(8));
  return held;
}

}  // namespace agnocast::test
