// SPDX-License-Identifier: Apache-2.0
//
// Memory policy: access of the data plane's templates to shared words. Programs use
// `SharedMemory`: real atomics in mapped regions, every call an inline load or store. The
// explorer in tests/model uses another policy with the same members, whose words are in a
// modelled memory with store buffers, so it checks the very statements that ship.
//
// A policy M provides
//   M::Region                     a mapped region (copyable)
//   M::word(region, byte_offset)  an object with load, store, fetch_or, fetch_and like std::atomic
//   M::fence()                    atomic_thread_fence(seq_cst)
//   M::step(Step)                 true; names the statement that follows (crash point, mutant)
//   M::holds(Step, bool)          the bool; names a decision
//   M::slot_capacity, …           array sizes of private memory
//   M::ring_count(), …            geometry of the regions
//   M::Zeroed<T>                  private memory for a T of that geometry, see zeroed.hpp
#pragma once

#include <agnocast/abi/client_region.hpp>
#include <agnocast/abi/limits.hpp>
#include <base/memory/zeroed.hpp>
#include <base/step.hpp>

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace agnocast {

/// Real shared memory. With AGNOCAST_CRASH_POINTS (tests only) every named step may end the
/// process; without, it costs nothing.
struct SharedMemory {
  using Region = std::byte*;
  template <class T>
  using Zeroed = agnocast::Zeroed<T>;

  static constexpr std::uint32_t slot_capacity = abi::slot_count_max;
  static constexpr std::uint32_t subscription_capacity = abi::subscription_count_max;
  static constexpr std::uint64_t ring_count() noexcept { return abi::ring_count; }
  static constexpr std::uint64_t publisher_count() noexcept { return abi::publisher_count_max; }
  static constexpr std::uint64_t near_slot_count() noexcept { return abi::near_slot_count; }

  static abi::SharedWord& word(Region region, std::uint64_t offset) noexcept {
    return *reinterpret_cast<abi::SharedWord*>(region + offset);
  }
  static void fence() noexcept { std::atomic_thread_fence(std::memory_order_seq_cst); }

#ifdef AGNOCAST_CRASH_POINTS
  static bool step(Step name) noexcept {
    crash_point(name);
    return true;
  }
#else
  static constexpr bool step(Step) noexcept { return true; }
#endif
  static constexpr bool holds(Step, bool condition) noexcept { return condition; }
};

}  // namespace agnocast
