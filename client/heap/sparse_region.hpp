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
#include <utility>

namespace agnocast {

/// One thread opens; whoever was given an address inside an opened range may use it.
class SparseRegion {
 public:
  SparseRegion() = default;
  SparseRegion(SparseRegion&& other) noexcept { swap(other); }
  SparseRegion& operator=(SparseRegion&& other) noexcept {
    SparseRegion gone(std::move(*this));
    swap(other);
    return *this;
  }
  ~SparseRegion();
  /// Reserves `bytes` of addresses for the region behind `fd`. Errors: os_failure,
  /// address_limit, lock_limit.
  [[nodiscard]] static Result<SparseRegion> make(UniqueFd fd, std::uint64_t bytes,
                                                 Mapping::Access access) noexcept;

  /// Makes [offset, offset + bytes) accessible, whole pages. Repeating it is harmless. Errors:
  /// invalid_argument (outside the region), os_failure, lock_limit. `file`: another descriptor of the region, when
  /// this one keeps none.
  [[nodiscard]] Result<void> open(std::uint64_t offset, std::uint64_t bytes,
                                  int file = -1) noexcept;
  bool has_file() const noexcept { return static_cast<bool>(fd_); }
  void keep_file(UniqueFd fd) noexcept { fd_ = std::move(fd); }
  /// Says to everybody who has this region that this process lives, for as long as it does and has the
  /// region; children of fork do not go on saying so. Only who may write can say it. Once. Errors:
  /// limit_reached, os_failure (as from a kernel, or a filter, without such locks).
  [[nodiscard]] Result<void> claim() noexcept;
  /// Whether the process that claimed it lives; true as well when nobody can know, without a file. One system call.
  bool is_claimed() const noexcept;
  std::byte* base() const noexcept { return reservation_.base(); }

 private:
  void swap(SparseRegion& other) noexcept;

  UniqueFd fd_;
  Mapping reservation_;
  Mapping::Access access_ = Mapping::Access::read;
  bool is_ours_ = false;  // claimed
};

}  // namespace agnocast
