// SPDX-License-Identifier: Apache-2.0
//
// AddressUsers: whose memory lies at which addresses of the arena in this process, and how often.
//
// Usually every window is here once. After the daemon's store was lost its owner brings it to the new
// daemon, and this process has it by two memberships: the same memory at the same place, which must
// stay until neither needs it. And a daemon that does not know yet who will bring what may give the
// same addresses to two owners: then the second is not mapped here, because what lies there is in use.
#pragma once

#include <agnocast/residency.hpp>

#include <atomic>
#include <cstdint>
#include <mutex>
#include <vector>

namespace agnocast {

class AddressUsers {
 public:
  /// The memory behind a descriptor; all zero if nobody knows.
  struct File {
    std::uint64_t device = 0;
    std::uint64_t inode = 0;
    friend bool operator==(const File&, const File&) = default;
  };
  static File file_of(int fd) noexcept;

  /// Of this process; immortal.
  static AddressUsers& instance() noexcept;

  static constexpr std::uint64_t own = 0;
  /// One more user of [base, base + bytes). `group`: another process's window, and the base of the first window
  /// of its group; or `own`. False when something else lies in a part of it, or there is no memory to note it.
  [[nodiscard]] bool enter(std::uint64_t base, std::uint64_t bytes, const File& file,
                           std::uint64_t group) noexcept;
  /// So much of it is mapped now, from its base.
  void mapped(std::uint64_t base, std::uint64_t bytes) noexcept;
  /// One user less. The last one's mappings are covered with the reservation.
  void leave(std::uint64_t base) noexcept;

  /// False: no window of another process was ever here.
  bool may_be_of_another(std::uint64_t address) const noexcept {
    return address >= lowest_.load(std::memory_order_relaxed) &&
           address < highest_.load(std::memory_order_relaxed);
  }
  /// What is mapped of the group that `address` is in; empty where it is in no window of another process.
  WindowSet group_of_another(std::uint64_t address) noexcept;

 private:
  struct Range {
    std::uint64_t base;
    std::uint64_t bytes;
    File file;
    std::uint64_t group;
    std::uint64_t users;
    std::uint64_t mapped;
  };
  std::mutex mutex_;
  std::vector<Range> ranges_;
  // Around all windows of others that there were. They only grow, so a look without the lock is as good.
  std::atomic<std::uint64_t> lowest_{~std::uint64_t{0}}, highest_{0};
};

}  // namespace agnocast
