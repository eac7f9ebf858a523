// SPDX-License-Identifier: Apache-2.0
//
// The kernel's view of an address in a process (/proc/PID/maps), independent of that process's
// own reports.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <string>

namespace demo {

struct MappedPlace {
  std::string permissions;  // "r--s"
  std::string device;
  std::uint64_t inode = 0;
  std::string name;          // "/memfd:… (deleted)"
  std::uint64_t offset = 0;  // of the address in the file

  bool is_same_byte_as(const MappedPlace& other) const {
    return device == other.device && inode == other.inode && inode != 0 && offset == other.offset;
  }
};

/// Returns nothing if nothing is mapped there, or /proc is not readable.
std::optional<MappedPlace> place_in(pid_t process, std::uint64_t address);

}  // namespace demo
