// SPDX-License-Identifier: Apache-2.0
//
// Address plan: which process owns which fixed range of addresses. Pure numbers.
//
// The arena is one range that every client reserves without memory when it says hello. It is cut
// into windows of equal length, and the daemon gives out the lowest free one. A window comes back
// only when the announce set of its owner's region is empty (rule RU), which the registry knows;
// nothing here infers it. Processes may have other mappings in the arena (obstacles.hpp): the plan
// then takes a window that obstructs as few processes as possible.
//
//   base                                                        base + bytes
//   | window 0 | window 1 | window 2 | …                        |
//
// The default base 0x2000'0000'0000 (35 TiB) lies above position-dependent programs and their
// heaps, below the mappings and stacks that Linux places (from 0x7fff… downwards), and in a gap of
// AddressSanitizer's shadow memory (below 0x1000'8000'0000 and at 0x7fff'8000). A machine with
// fewer address bits gets a smaller arena further down.
#pragma once

#include <cstdint>
#include <optional>
#include <set>
#include <span>

namespace agnocast::daemon {

struct Arena {
  std::uint64_t base = 0;
  std::uint64_t bytes = 0;
  std::uint64_t window_bytes = 0;
};

/// What the configuration asks for; zero leaves the choice to plan_arena().
struct ArenaWish {
  std::uint64_t base = 0;
  std::uint64_t bytes = 0;
  std::uint64_t window_bytes = 0;
};

/// Returns the arena for a machine with `address_bits` of user addresses (47 on x86-64, 39 to 48
/// on AArch64) and `memory_bytes` of RAM. Returns nothing when the wish does not fit or is not a
/// multiple of abi::window_granule_bytes.
std::optional<Arena> plan_arena(const ArenaWish& wish, unsigned address_bits,
                                std::uint64_t memory_bytes) noexcept;

/// Addresses that some process cannot use for windows.
struct Obstacle {
  static constexpr std::uint64_t forbids = ~std::uint64_t{0};
  std::uint64_t base = 0;
  std::uint64_t bytes = 0;
  std::uint64_t weight =
      1;  // number of processes that a window here obstructs; forbids: never use it
};

class AddressPlan {
 public:
  /// `former_count`: number of earlier daemons. Processes that have not reconnected yet may still
  /// use windows of those, so each daemon begins in another eighth of the arena.
  explicit AddressPlan(const Arena& arena, std::uint64_t former_count = 0) noexcept
      : arena_(arena),
        count_(arena.bytes / arena.window_bytes),
        start_(count_ * (former_count % 8) / 8) {}

  const Arena& arena() const noexcept { return arena_; }
  std::uint64_t window_count() const noexcept { return count_; }
  std::uint64_t used_count() const noexcept { return used_.size(); }

  struct Choice {
    std::uint64_t base = 0;
    std::uint64_t weight = 0;  // total of the obstacles in the window
    friend bool operator==(const Choice&, const Choice&) = default;
  };
  /// Returns the free window with the least weight; among equals, the first from where this plan
  /// begins. Returns nothing when no free window is allowed.
  std::optional<Choice> best(std::span<const Obstacle> obstacles = {}) const;
  /// Returns the same window as best() and marks it as used.
  std::optional<Choice> take(std::span<const Obstacle> obstacles = {});
  /// Marks a window as used. A restarted daemon calls it for each window in its tables.
  bool adopt(std::uint64_t base);
  /// Frees the window at `base`. Returns false when it was not in use.
  bool give_back(std::uint64_t base);

 private:
  std::optional<std::uint64_t> lowest_free(std::uint64_t begin, std::uint64_t end) const;

  Arena arena_;
  std::uint64_t count_;
  std::uint64_t start_;
  std::set<std::uint64_t> used_;  // numbers of the windows in use
};

}  // namespace agnocast::daemon
