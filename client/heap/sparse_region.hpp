// SPDX-License-Identifier: Apache-2.0
//
// SparseRegion: a client region, or the board, as one process maps it: all addresses reserved,
// only the used pages accessible. A region has a GiB of addresses, of which a few hundred KiB
// exist; mapping it whole in a process that has called mlockall(MCL_FUTURE) would allocate all of
// it.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <base/memory/mapping.hpp>

#include <cstddef>
#include <cstdint>
#include <map>
#include <utility>

namespace agnocast {

/// One thread opens; any thread may use an address inside an opened range.
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

  /// Makes [offset, offset + bytes) accessible, whole pages. May be repeated: pages that are
  /// accessible stay as they are. Errors:
  /// invalid_argument (outside the region), os_failure, lock_limit. `file`: another descriptor of
  /// the region, if this object keeps none.
  [[nodiscard]] Result<void> open(std::uint64_t offset, std::uint64_t bytes,
                                  int file = -1) noexcept;
  bool has_file() const noexcept { return static_cast<bool>(fd_); }
  void keep_file(UniqueFd fd) noexcept { fd_ = std::move(fd); }
  /// Shows all processes with this region that this process lives, as long as it does and has the
  /// region; forked children do not prolong that. Needs write access. Call it once. Errors:
  /// limit_reached, os_failure (also if the kernel, or a filter, does not support such locks).
  [[nodiscard]] Result<void> claim() noexcept;
  /// Returns whether the process that claimed it lives; true as well if unknown, without a file.
  /// One system call.
  bool is_claimed() const noexcept;
  std::byte* base() const noexcept { return reservation_.base(); }

 private:
  void swap(SparseRegion& other) noexcept;
  bool is_open(std::uint64_t offset, std::uint64_t end) const noexcept;
  void note_open(std::uint64_t offset, std::uint64_t end) noexcept;

  UniqueFd fd_;
  Mapping reservation_;
  Mapping::Access access_ = Mapping::Access::read;
  bool is_ours_ = false;                         // claimed
  std::map<std::uint64_t, std::uint64_t> open_;  // accessible ranges: beginning and end
};

}  // namespace agnocast
