// SPDX-License-Identifier: Apache-2.0
//
// Arena: the planned range of addresses in this process. All of it is reserved without memory,
// except the ranges that were in use before: these are *blocked*, in whole window granules.
//
//   | reserved (PROT_NONE)      | blocked: a JIT's | reserved                            |
//
// Nothing is moved or replaced: a window with a blocked part is not mapped here. Reserved
// addresses stay reserved: later mappings go elsewhere, unless other code maps over them with
// MAP_FIXED, which cannot be prevented.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/result.hpp>
#include <base/memory/mapping.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace agnocast {

class Arena {
 public:
  struct Blocked {
    std::uint64_t base = 0;
    std::uint64_t bytes = 0;
    std::string what;  // the first mapping in it, as in /proc/self/maps
  };

  /// Reserves the free parts of [base, base + bytes). Errors: arena_occupied (none is free),
  /// address_limit, lock_limit, os_failure.
  [[nodiscard]] static Result<Arena> reserve(std::uint64_t base, std::uint64_t bytes);

  std::uint64_t base() const noexcept { return base_; }
  std::uint64_t bytes() const noexcept { return bytes_; }
  /// Returns whether all of [base, base + bytes) is in the arena. Any values.
  bool contains(std::uint64_t base, std::uint64_t bytes) const noexcept;
  /// Returns whether all of it is reserved here, so that it may be mapped over.
  bool has(std::uint64_t base, std::uint64_t bytes) const noexcept;
  /// Returns at most abi::blocked_count_max ranges, in order.
  const std::vector<Blocked>& blocked() const noexcept { return blocked_; }

 private:
  std::uint64_t base_ = 0;
  std::uint64_t bytes_ = 0;
  std::vector<Mapping> reserved_;
  std::vector<Blocked> blocked_;
};

}  // namespace agnocast
