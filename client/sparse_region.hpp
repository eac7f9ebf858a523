// SPDX-License-Identifier: Apache-2.0
//
// SparseRegion: a client region, or the board, as one process maps it: all of its addresses
// reserved, only the pages in use accessible. A region is a GiB of addresses of which a few hundred
// KiB exist; mapping it whole in a process that has called mlockall(MCL_FUTURE) would make all of it
// exist.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/result.hpp>
#include <base/mapping.hpp>
#include <base/unique_fd.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast {

/// One thread opens; whoever was given an address inside an opened range may use it.
class SparseRegion {
 public:
  SparseRegion() = default;
  /// Reserves `bytes` of addresses for the region behind `fd`. Errors: os_failure,
  /// address_limit, lock_limit.
  [[nodiscard]] static Result<SparseRegion> make(UniqueFd fd, std::uint64_t bytes,
                                                 Mapping::Access access) noexcept;

  /// Makes [offset, offset + bytes) accessible, whole pages. Repeating it is harmless. Errors:
  /// invalid_argument (outside the region), os_failure, lock_limit.
  [[nodiscard]] Result<void> open(std::uint64_t offset, std::uint64_t bytes) noexcept;
  /// Says to everybody who has this region that this process lives; the kernel takes it back when it
  /// ends. Where it cannot be said, the process counts as gone for those who ask.
  void claim() const noexcept;
  /// Whether the process that claimed it lives. One system call.
  bool is_claimed() const noexcept;
  std::byte* base() const noexcept { return reservation_.base(); }

 private:
  UniqueFd fd_;
  Mapping reservation_;
  Mapping::Access access_ = Mapping::Access::read;
};

}  // namespace agnocast
