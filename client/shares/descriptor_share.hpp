// SPDX-License-Identifier: Apache-2.0
//
// PeerShare: limits how many resources of this process its peers may use. DescriptorShare counts
// descriptors, MappingShare mappings.
//
// A peer costs doorbells (one or two for each of its wait sets and each publisher here), the file
// of its region and those of its windows. A user with enough processes would otherwise use up all
// descriptors of this process, and no other peer could be attached. So one foreign user gets a
// quarter of the soft limit and all foreign users together half; no peer of any user gets one of
// the last few. A peer beyond its share is attached without: its doorbell is mute, and the file
// of its region is closed once it is mapped. Mappings (vm.max_map_count) have the same shares: a
// peer's region costs two, and each of its endpoints and windows two more (a subscription of a wide
// topic four), because it splits a reservation. A peer beyond its share of mappings is not mapped:
// its publishers cannot be read, and its subscriptions cannot be attached.
//
//   Part part = DescriptorShare::instance().take(owner, 2);   empty: close them
//
// One per process, for all its sessions. Any thread.
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
  /// Descriptors left to the program, and to packets whose descriptors are closed again.
  static constexpr unsigned left_free = 16;

  /// Counts as long as it lives. Its destructor takes no lock: a forked child may inherit one
  /// held by another thread.
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
    Sum* user_ = nullptr;  // null: not counted
    Sum* all_ = nullptr;
    std::uint64_t count_ = 0;
    bool is_granted_ = false;
  };

  /// Takes `count`, which are open already. Returns empty if they exceed the share, or hardly any
  /// number is free.
  [[nodiscard]] Part take(Owner owner, std::uint64_t count);
  /// Returns true once after each refusal, when a peer like the refused one would get some.
  bool has_more() noexcept;

 protected:
  PeerShare() = default;
  PeerShare(const PeerShare&) = delete;
  PeerShare& operator=(const PeerShare&) = delete;
  ~PeerShare() = default;
  /// Returns the limit that the shares are parts of.
  virtual std::uint64_t limit() const noexcept = 0;
  virtual bool are_free(unsigned count) const noexcept = 0;

 private:
  bool fits(Owner owner, std::uint64_t count) const noexcept;  // under the mutex

  std::mutex mutex_;
  std::map<std::uint32_t, Part::Sum> used_;  // by foreign uid; stays, as parts refer to it
  Part::Sum foreign_{0};                     // their sum
  bool was_refused_ = false;
  Owner refused_;  // the last refused one
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
  /// Cost of one part mapped into a reservation: itself, and the rest of the reservation behind
  /// it.
  static constexpr std::uint64_t of_one_part = 2;
  /// Immortal.
  static MappingShare& instance() noexcept;

 private:
  std::uint64_t limit() const noexcept override;
  /// Always true: the kernel checks when they are mapped.
  bool are_free(unsigned) const noexcept override { return true; }
};

/// Returns whether `count` descriptors are free now, at most twice left_free. A few system calls
/// for each.
bool can_open(unsigned count) noexcept;

}  // namespace agnocast
