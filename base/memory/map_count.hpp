// SPDX-License-Identifier: Apache-2.0
//
// The kernel's limit of mappings per process.
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <unistd.h>

#include <charconv>
#include <cstdint>

namespace agnocast {

/// Returns vm.max_map_count, or its default if it cannot be read.
inline std::uint64_t read_map_count_max() noexcept {
  const UniqueFd file(::open("/proc/sys/vm/max_map_count", O_RDONLY | O_CLOEXEC));
  char text[24];
  const ssize_t bytes = file ? ::read(file.get(), text, sizeof text) : -1;
  std::uint64_t count = 65'530;
  if (bytes > 0) std::from_chars(text, text + bytes, count);
  return count;
}

}  // namespace agnocast
