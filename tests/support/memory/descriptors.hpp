// SPDX-License-Identifier: Apache-2.0
//
// Descriptors of this process: counted to find leaks, compared to see that the right one arrived.
// And a descriptor of another process, found by the name of its file.
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <dirent.h>
#include <fcntl.h>
#include <sys/stat.h>

#include <cstddef>
#include <filesystem>
#include <string>

namespace agnocast::test {

/// Returns the number of entries of /proc/self/fd. Always includes the one for reading it.
inline std::size_t open_descriptor_count() {
  DIR* const directory = ::opendir("/proc/self/fd");
  std::size_t count = 0;
  while (::readdir(directory) != nullptr) ++count;
  ::closedir(directory);
  return count;
}

inline bool is_close_on_exec(int fd) {
  const int flags = ::fcntl(fd, F_GETFD);
  return flags >= 0 && (flags & FD_CLOEXEC) != 0;
}

inline bool is_non_blocking(int fd) {
  const int flags = ::fcntl(fd, F_GETFL);
  return flags >= 0 && (flags & O_NONBLOCK) != 0;
}

/// Returns whether both are descriptors of the same file.
inline bool is_same_file(int left, int right) {
  struct stat a {};
  struct stat b {};
  return ::fstat(left, &a) == 0 && ::fstat(right, &b) == 0 && a.st_dev == b.st_dev &&
         a.st_ino == b.st_ino;
}

/// Reopens a descriptor of another process whose file has `name` in its path.
inline UniqueFd descriptor_of(pid_t pid, const std::string& name) {
  const std::string directory = "/proc/" + std::to_string(pid) + "/fd/";
  for (const auto& entry : std::filesystem::directory_iterator(directory)) {
    std::error_code ignored;
    if (std::filesystem::read_symlink(entry.path(), ignored).string().find(name) !=
        std::string::npos)
      return UniqueFd(::open(entry.path().c_str(), O_RDWR | O_CLOEXEC));
  }
  return UniqueFd();
}

}  // namespace agnocast::test
