// SPDX-License-Identifier: Apache-2.0
//
// PeerHeap: somebody else's heap windows, read-only, at the addresses where their owner has them.
//
// The whole window is reserved without access first; only what the owner's frontier says is in use
// gets mapped. A process that has locked its memory (mlockall) would otherwise allocate the whole
// window. Left out of core dumps, never populated: touching a hole through a read-only mapping
// allocates a page.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/result.hpp>
#include <base/mapping.hpp>
#include <base/unique_fd.hpp>

#include <array>
#include <cstddef>
#include <cstdint>

namespace agnocast {

/// Not thread-safe: one owner per process serialises add() and open(); contains() may run beside
/// neither.
class PeerHeap {
 public:
  /// `client_region`: the owner's, mapped here read-only; must outlive this.
  explicit PeerHeap(std::byte* client_region) noexcept : client_region_(client_region) {}

  /// A window as the daemon announced it: `fd` opened for reading, [base, base + length) free in
  /// this process or reserved by `reserved`. Errors: os_failure (EEXIST: something is in the way),
  /// invalid_argument (too many windows).
  [[nodiscard]] Result<void> add(std::uint64_t base, std::uint64_t length, UniqueFd fd) noexcept;

  /// Makes accessible what the owner has put to use since the last call. A system call only after
  /// growth.
  void open() noexcept;
  /// True when [address, address + size) lies in what is open. Any values.
  bool contains(std::uint64_t address, std::uint64_t size) const noexcept;

 private:
  struct Window {
    Mapping reservation;
    UniqueFd fd;
    std::uint64_t base = 0;
    std::uint64_t length = 0;
    std::uint64_t opened = 0;  // bytes
  };

  std::byte* client_region_;
  std::array<Window, abi::window_count_max> windows_;
  std::uint64_t count_ = 0;
};

}  // namespace agnocast
