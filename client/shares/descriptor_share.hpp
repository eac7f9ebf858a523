// SPDX-License-Identifier: Apache-2.0
//
// PeerShare: how many of some thing of this process its peers may cause. DescriptorShare counts descriptors, MappingShare
// mappings.
//
// A peer costs bells (one or two for each of its sleepers and each publisher here), the file of its region and those of
// its windows. A user who starts processes enough would take all numbers that this process may open, and nobody
// else could be attached. So one foreign user gets a quarter of the soft limit and all foreign users together half;
// whatever its user, no peer gets any of the last few. Who gets none is attached without: its bell is mute, the file of its region
// is closed once it is mapped. Of mappings (vm.max_map_count) the shares are the same: a peer's region costs two, and each
// endpoint of it and each window two more, as it splits what is reserved. Who gets none is not mapped: of a
// publisher nothing can be read, and a subscription is one that cannot be attached.
//
//   Part part = DescriptorShare::instance().take(owner, 2);   empty: close them
//
// Of this process, whatever memberships it has. Any thread.
#pragma once

#include <client/shares/peer_owner.hpp>

#include <atomic>
#include <cstdint>
#include <map>
#include <mutex>
#include <utility>

namespace agnocast {

class PeerShare {
 public:
  using Owner = PeerOwner;
  static constexpr std::uint64_t foreign_user_divisor = 4, foreign_divisor = 2;
  /// Numbers that are left to the program, and to packets with descriptors that are closed again.
  static constexpr unsigned left_free = 16;

  /// Counted as long as it lives. Its end takes no lock: a forked child may inherit that of another thread.
  class Part {
   public:
    Part() = default;
    Part(Part&& other) noexcept { swap(other); }
    Part& operator=(Part&& other) noexcept {
      swap(other);
      return *this;
    }
    ~Part() {
      if (user_ == nullptr) return;
      user_->fetch_sub(count_, std::memory_order_relaxed);
      all_->fetch_sub(count_, std::memory_order_relaxed);
    }
    explicit operator bool() const noexcept { return is_granted_; }

   private:
    friend class PeerShare;
    using Sum = std::atomic<std::uint64_t>;
    Part(Sum* user, Sum* all, std::uint64_t count) noexcept
        : user_(user), all_(all), count_(count), is_granted_(true) {}
    void swap(Part& other) noexcept {
      std::swap(user_, other.user_);
      std::swap(all_, other.all_);
      std::swap(count_, other.count_);
      std::swap(is_granted_, other.is_granted_);
    }
    Sum* user_ = nullptr;  // null: nobody counts them
    Sum* all_ = nullptr;
    std::uint64_t count_ = 0;
    bool is_granted_ = false;
  };

  /// For so many, which are open already. Empty: they are more than the share, or hardly any number is free.
  [[nodiscard]] Part take(Owner owner, std::uint64_t count);
  /// Once for each time that somebody got none and would get some now.
  bool has_more() noexcept;

 protected:
  PeerShare() = default;
  PeerShare(const PeerShare&) = delete;
  PeerShare& operator=(const PeerShare&) = delete;
  ~PeerShare() = default;
  /// Of which this is a share.
  virtual std::uint64_t limit() const noexcept = 0;
  virtual bool are_free(unsigned count) const noexcept = 0;

 private:
  bool fits(Owner owner, std::uint64_t count) const noexcept;  // under the mutex

  std::mutex mutex_;
  std::map<std::uint32_t, Part::Sum> used_;  // by foreign uid; stays, as parts refer to it
  Part::Sum foreign_{0};                     // their sum
  bool was_refused_ = false;
  Owner refused_;  // the last one
};

class DescriptorShare final : public PeerShare {
 public:
  /// Immortal.
  static DescriptorShare& instance() noexcept;

 private:
  std::uint64_t limit() const noexcept override;
  bool are_free(unsigned count) const noexcept override;
};

class MappingShare final : public PeerShare {
 public:
  /// What one part costs that is mapped into a reservation: itself, and the rest of the reservation behind it.
  static constexpr std::uint64_t of_one_part = 2;
  /// Immortal.
  static MappingShare& instance() noexcept;

 private:
  std::uint64_t limit() const noexcept override;
  /// The kernel says so when they are mapped.
  bool are_free(unsigned) const noexcept override { return true; }
};

/// Whether so many numbers are free now, at most twice left_free. A few system calls for each.
bool can_open(unsigned count) noexcept;

}  // namespace agnocast
