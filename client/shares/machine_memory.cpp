// SPDX-License-Identifier: Apache-2.0

#include <base/descriptors/unique_fd.hpp>
#include <client/shares/machine_memory.hpp>

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <climits>
#include <cstdio>
#include <limits>
#include <string_view>

namespace agnocast {
namespace {

constexpr std::uint64_t no_bound = std::numeric_limits<std::uint64_t>::max();
using Text = char[PATH_MAX];

/// Reads the beginning of a file, at most one buffer.
std::string_view contents_of(const char* path, Text& buffer) noexcept {
  const UniqueFd file(::open(path, O_RDONLY | O_CLOEXEC));
  const ssize_t got = file ? ::read(file.get(), buffer, sizeof buffer) : -1;
  return {buffer, got > 0 ? static_cast<std::size_t>(got) : 0};
}

/// Returns the number; "max" and other texts are no bound.
std::uint64_t bound_in(std::string_view text) noexcept {
  std::uint64_t bytes = no_bound;
  const auto end = std::from_chars(text.data(), text.data() + text.size(), bytes);
  return end.ec == std::errc() ? bytes : no_bound;
}

/// Returns PATH in the line "0::/PATH" of /proc/self/cgroup.
std::string_view group_in(std::string_view text) noexcept {
  constexpr std::string_view unified = "0::";
  while (!text.empty()) {
    const std::string_view line = text.substr(0, text.find('\n'));
    if (line.substr(0, unified.size()) == unified) return line.substr(unified.size());
    text.remove_prefix(std::min(text.size(), line.size() + 1));
  }
  return {};
}

}  // namespace

std::uint64_t machine_memory_bytes(const char* root) noexcept {
  const long pages = ::sysconf(_SC_PHYS_PAGES), page = ::sysconf(_SC_PAGESIZE);
  std::uint64_t bytes = pages > 0 && page > 0
                            ? static_cast<std::uint64_t>(pages) * static_cast<std::uint64_t>(page)
                            : no_bound;
  Text path, lines, number;
  std::snprintf(path, sizeof path, "%s/proc/self/cgroup", root);
  std::string_view group = group_in(contents_of(path, lines));
  for (;;) {
    std::snprintf(path, sizeof path, "%s/sys/fs/cgroup%.*s/memory.max", root,
                  static_cast<int>(group.size()), group.data());
    bytes = std::min(bytes, bound_in(contents_of(path, number)));
    if (group.empty())
      return bytes;  // the root of a container has a bound, that of the machine has no such file
    group = group.substr(0, std::min(group.size() - 1, group.rfind('/')));
  }
}

}  // namespace agnocast
