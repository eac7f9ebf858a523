// SPDX-License-Identifier: Apache-2.0
//
// AlignedRegion: zeroed private memory aligned like a mapping, for tests that need a region but no
// memfd.
#pragma once

#include <agnocast/abi/limits.hpp>

#include <cstddef>
#include <cstdint>
#include <vector>

namespace agnocast::test {

class AlignedRegion {
 public:
  explicit AlignedRegion(std::uint64_t bytes = 1 << 18) : lines_(bytes / sizeof(Line)) {}
  std::byte* base() { return lines_.front().bytes; }

 private:
  struct alignas(abi::cache_line_bytes) Line {
    std::byte bytes[abi::cache_line_bytes];
  };
  std::vector<Line> lines_;
};

}  // namespace agnocast::test
