// SPDX-License-Identifier: Apache-2.0
//
// Arena: the planned range of addresses as this process has it. All of it is reserved without memory,
// but for what was in use before: the ranges that are *blocked*, in whole window granules.
//
//   | reserved (PROT_NONE)      | blocked: a JIT's | reserved                            |
//
// Nothing is moved and nothing is replaced: a window of which a part is blocked is not mapped here.
// What is reserved stays so: later mappings go elsewhere, unless somebody maps over it with
// MAP_FIXED, which nobody can prevent.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/result.hpp>
#include <base/mapping.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace agnocast {

class Arena {
 public:
  struct Blocked {
    std::uint64_t base = 0;
    std::uint64_t bytes = 0;
    std::string what;  // the first of what lies there, as /proc/self/maps has it
  };

  /// Reserves what is free of [base, base + bytes). Errors: arena_occupied (nothing is), address_limit,
  /// lock_limit, os_failure.
  [[nodiscard]] static Result<Arena> reserve(std::uint64_t base, std::uint64_t bytes);

  std::uint64_t base() const noexcept { return base_; }
  std::uint64_t bytes() const noexcept { return bytes_; }
  /// Whether all of [base, base + bytes) lies in the arena. Any values.
  bool contains(std::uint64_t base, std::uint64_t bytes) const noexcept;
  /// Whether all of it is reserved here, so that it may be mapped over.
  bool has(std::uint64_t base, std::uint64_t bytes) const noexcept;
  /// At most abi::blocked_count_max, in order.
  const std::vector<Blocked>& blocked() const noexcept { return blocked_; }

 private:
  std::uint64_t base_ = 0;
  std::uint64_t bytes_ = 0;
  std::vector<Mapping> reserved_;
  std::vector<Blocked> blocked_;
};

}  // namespace agnocast
