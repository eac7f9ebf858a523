// SPDX-License-Identifier: Apache-2.0
//
// AddressUsers: records which memory lies at which addresses of the arena in this process, and
// how often.
//
// Usually every window is here once. After the daemon's store was lost, its owner brings it to
// the new daemon, and this process has it in two sessions: the same memory at the same address,
// which must stay until neither session needs it. And a daemon that does not know yet which
// windows will be brought may give the same addresses to two owners: then the second one is not
// mapped here, because the addresses are in use.
#pragma once

#include <agnocast/residency.hpp>

#include <atomic>
#include <cstdint>
#include <mutex>
#include <vector>

namespace agnocast {

class AddressUsers {
 public:
  /// Identity of the memory behind a descriptor; all zero if unknown.
  struct File {
    std::uint64_t device = 0;
    std::uint64_t inode = 0;
    friend bool operator==(const File&, const File&) = default;
  };
  static File file_of(int fd) noexcept;

  /// One per process; immortal.
  static AddressUsers& instance() noexcept;

  static constexpr std::uint64_t own = 0;
  /// Adds a user of [base, base + bytes). `window_set`: base of the first window of the window set,
  /// for another process's window; or `own`. Returns false if a part is occupied by something
  /// else, or there is no memory to record it.
  [[nodiscard]] bool enter(std::uint64_t base, std::uint64_t bytes, const File& file,
                           std::uint64_t window_set) noexcept;
  /// Records that `bytes` of it are mapped now, from its base.
  void mapped(std::uint64_t base, std::uint64_t bytes) noexcept;
  /// Removes a user. After the last one, the reservation replaces the mappings.
  void leave(std::uint64_t base) noexcept;

  /// Returns false if no window of another process was ever at this address.
  bool may_be_of_another(std::uint64_t address) const noexcept {
    return address >= lowest_.load(std::memory_order_relaxed) &&
           address < highest_.load(std::memory_order_relaxed);
  }
  /// Returns the mapped part of the window set of `address`; empty if that is in no window of
  /// another process.
  WindowSet window_set_of_another(std::uint64_t address) noexcept;

 private:
  struct Range {
    std::uint64_t base;
    std::uint64_t bytes;
    File file;
    std::uint64_t window_set;
    std::uint64_t users;
    std::uint64_t mapped;
  };
  std::mutex mutex_;
  std::vector<Range> ranges_;
  // Bounds of all foreign windows so far. They only grow, so reading them without the lock is
  // safe.
  std::atomic<std::uint64_t> lowest_{~std::uint64_t{0}}, highest_{0};
};

}  // namespace agnocast
