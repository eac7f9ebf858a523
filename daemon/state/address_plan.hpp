// SPDX-License-Identifier: Apache-2.0
//
// Address plan: which process owns which fixed range of addresses. Pure numbers.
//
// The arena is one range that every client reserves without memory when it says hello; it is cut
// into windows of equal length, and the lowest free one is given out. A window comes back only when
// the announce set of its owner's region is empty (rule RU), which the registry knows; nothing here
// infers it. Processes may have something else in the arena (obstacles.hpp): a window is then taken
// where as few as possible have.
//
//   base                                                        base + bytes
//   | window 0 | window 1 | window 2 | …                        |
//
// The default base 0x2000'0000'0000 (35 TiB) lies above where position-dependent programs and their
// heaps are, below where Linux puts mappings and stacks (from 0x7fff… downwards), and in a gap of
// the shadows of AddressSanitizer (below 0x1000'8000'0000 and at 0x7fff'8000). A machine with fewer
// address bits gets a smaller arena further down.
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

/// What the configuration wishes, zero where it leaves the choice.
struct ArenaWish {
  std::uint64_t base = 0;
  std::uint64_t bytes = 0;
  std::uint64_t window_bytes = 0;
};

/// The arena for a machine: `address_bits` of user addresses (47 on x86-64, 39 to 48 on AArch64)
/// and `memory_bytes` of RAM. Nothing when the wish does not fit or is not of whole granules
/// (abi::window_granule_bytes).
std::optional<Arena> plan_arena(const ArenaWish& wish, unsigned address_bits,
                                std::uint64_t memory_bytes) noexcept;

/// Addresses that some process cannot use for windows.
struct Obstacle {
  static constexpr std::uint64_t forbids = ~std::uint64_t{0};
  std::uint64_t base = 0;
  std::uint64_t bytes = 0;
  std::uint64_t weight =
      1;  // how much a window there is to be avoided; forbids: it is out of the question
};

class AddressPlan {
 public:
  /// `former_count`: daemons that were here before. Windows that they gave may still be in use by
  /// processes that have not come back yet, so this one begins in another eighth of the arena.
  explicit AddressPlan(const Arena& arena, std::uint64_t former_count = 0) noexcept
      : arena_(arena),
        count_(arena.bytes / arena.window_bytes),
        start_(count_ * (former_count % 8) / 8) {}

  const Arena& arena() const noexcept { return arena_; }
  std::uint64_t window_count() const noexcept { return count_; }
  std::uint64_t used_count() const noexcept { return used_.size(); }

  struct Choice {
    std::uint64_t base = 0;
    std::uint64_t weight = 0;  // of the obstacles in it, together
    friend bool operator==(const Choice&, const Choice&) = default;
  };
  /// The free window with the least weight, of those the first from where this plan begins; nothing
  /// when none is free and allowed.
  std::optional<Choice> best(std::span<const Obstacle> obstacles = {}) const;
  /// The same; it is not free any more.
  std::optional<Choice> take(std::span<const Obstacle> obstacles = {});
  /// Marks a window as given out: what the tables say when the daemon starts again.
  bool adopt(std::uint64_t base);
  /// The window at `base` is free again. False when it was not given out.
  bool give_back(std::uint64_t base);

 private:
  std::optional<std::uint64_t> lowest_free(std::uint64_t begin, std::uint64_t end) const;

  Arena arena_;
  std::uint64_t count_;
  std::uint64_t start_;
  std::set<std::uint64_t> used_;  // numbers of the windows that are given out
};

}  // namespace agnocast::daemon
