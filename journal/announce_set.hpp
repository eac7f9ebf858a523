// SPDX-License-Identifier: Apache-2.0
//
// Announce set: the processes notified about one generation of a reusable object (rule RU,
// docs/protocol.md, "Rules that everything follows from").
//
// A publisher index, an extent, a client region, a heap window or its addresses may be reused
// only when every process that was ever sent an announcement of that generation has sent UNLINKED
// or is dead. The set is part of the daemon's logged tables; it is never inferred from shared
// memory. Four details are mandatory:
//   (a) notify() is logged before the announcement is sent
//   (b) a client sends UNLINKED after its link is gone
//   (c) a restarted daemon sends every process its announcements again
//   (d) a client answers a repeated one with UNLINKED again
#pragma once

#include <agnocast/abi/limits.hpp>
#include <base/memory/memory_policy.hpp>
#include <journal/steps.hpp>

#include <cstdint>

namespace agnocast::journal {

/// Plain data: stored in the daemon's tables as it is.
template <class M, std::uint32_t client_capacity = abi::client_count_max>
class AnnounceSet {
 public:
  /// Begins a new generation. Only if reusable().
  void begin(std::uint64_t generation) noexcept { generation_ = generation; }
  std::uint64_t generation() const noexcept { return generation_; }

  void notify(std::uint64_t client) noexcept {
    AGNOCAST_STEP(R1_tell) clients_[client / 64] |= bit(client);
  }
  /// Removes a client that sent UNLINKED. A packet about another generation is late and ignored.
  void acknowledge(std::uint64_t client, std::uint64_t generation) noexcept {
    if (!M::holds(steps::R2_generation, generation == generation_)) return;
    AGNOCAST_STEP(R2_unmapped) clients_[client / 64] &= ~bit(client);
  }
  void died(std::uint64_t client) noexcept {
    AGNOCAST_STEP(R3_died) clients_[client / 64] &= ~bit(client);
  }
  bool contains(std::uint64_t client) const noexcept {
    return (clients_[client / 64] & bit(client)) != 0;
  }
  bool reusable() const noexcept {
    std::uint64_t notified = 0;
    for (std::uint64_t word : clients_) notified |= word;
    return M::holds(steps::R4_reusable, notified == 0);
  }

 private:
  static constexpr std::uint64_t bit(std::uint64_t client) noexcept {
    return std::uint64_t{1} << client % 64;
  }

  std::uint64_t generation_ = 0;
  std::uint64_t clients_[(client_capacity + 63) / 64] = {};
};

/// The client's side: decides what to do with an announcement. One per index; plain data, private
/// to the process.
template <class M>
class AnnouncementState {
 public:
  enum class Action : std::uint8_t { link, nothing, say_unlinked };

  Action on_announce(std::uint64_t generation) const noexcept {
    if (M::holds(steps::R5_again, generation <= unlinked_)) return Action::say_unlinked;
    return generation == linked_ ? Action::nothing : Action::link;
  }
  void linked(std::uint64_t generation) noexcept { AGNOCAST_STEP(R6_link) linked_ = generation; }
  /// Call it after the link is gone, before sending UNLINKED.
  void unlinked(std::uint64_t generation) noexcept {
    AGNOCAST_STEP(R7_unlinked) unlinked_ = generation;
    linked_ = 0;
  }
  std::uint64_t current() const noexcept { return linked_; }

 private:
  std::uint64_t linked_ = 0;
  std::uint64_t unlinked_ = 0;
};

}  // namespace agnocast::journal
