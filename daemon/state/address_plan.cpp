// SPDX-License-Identifier: Apache-2.0

#include <daemon/state/address_plan.hpp>

#include <agnocast/abi/limits.hpp>

#include <algorithm>
#include <iterator>
#include <map>

namespace agnocast::daemon {
namespace {

constexpr std::uint64_t gib = std::uint64_t{1} << 30;
constexpr std::uint64_t default_base = 0x2000'0000'0000;
constexpr std::uint64_t default_bytes = 8192 * gib;
constexpr std::uint64_t default_window_bytes = 16 * gib;
// A smaller window would hold only a handful of camera images.
constexpr std::uint64_t least_window_bytes = gib / 16;

constexpr std::uint64_t round_down(std::uint64_t value, std::uint64_t unit) noexcept {
  return value / unit * unit;
}

}  // namespace

std::optional<Arena> plan_arena(const ArenaWish& wish, unsigned address_bits,
                                std::uint64_t memory_bytes) noexcept {
  if (address_bits < 32 || address_bits > 56) return std::nullopt;
  const std::uint64_t space = std::uint64_t{1} << address_bits;
  Arena arena;
  // With 47 bits the default fits: 32 + 8 of 128 TiB. Otherwise the arena begins at a quarter of
  // the address space and takes a sixteenth of it.
  const bool wide = space >= 4 * default_base;
  arena.base = wish.base != 0 ? wish.base : wide ? default_base : space / 4;
  arena.bytes = wish.bytes != 0 ? wish.bytes : wide ? default_bytes : space / 16;
  if (wish.window_bytes != 0) {
    arena.window_bytes = wish.window_bytes;
  } else {
    // One process should not hold more than a quarter of the memory, and at least 64 processes
    // must find a window.
    arena.window_bytes = std::min({default_window_bytes, memory_bytes / 4, arena.bytes / 64});
    arena.window_bytes =
        std::max(round_down(arena.window_bytes, least_window_bytes), least_window_bytes);
  }
  if (arena.base % abi::window_granule_bytes != 0 || arena.bytes % abi::page_bytes != 0 ||
      arena.window_bytes % abi::window_granule_bytes != 0)
    return std::nullopt;
  if (arena.window_bytes == 0 || arena.bytes < arena.window_bytes) return std::nullopt;
  if (arena.base >= space || arena.bytes > space - arena.base) return std::nullopt;
  return arena;
}

std::optional<std::uint64_t> AddressPlan::lowest_free(std::uint64_t begin,
                                                      std::uint64_t end) const {
  for (auto used = used_.lower_bound(begin); used != used_.end() && *used == begin; ++used) ++begin;
  if (begin >= end) return std::nullopt;
  return begin;
}

// All windows between two neighbouring edges of obstacles have the same weight.
std::optional<AddressPlan::Choice> AddressPlan::best(std::span<const Obstacle> obstacles) const {
  struct Change {
    std::uint64_t weight = 0;
    std::uint64_t less = 0;
    std::int64_t forbidding = 0;
  };
  std::map<std::uint64_t, Change> edges{{0, {}}, {start_, {}}, {count_, {}}};
  for (const Obstacle& obstacle : obstacles) {
    const std::uint64_t base = std::max(obstacle.base, arena_.base) - arena_.base;
    const std::uint64_t end = std::max(obstacle.base + obstacle.bytes, arena_.base) - arena_.base;
    const std::uint64_t first = std::min(base / arena_.window_bytes, count_);
    const std::uint64_t last =
        std::min((end + arena_.window_bytes - 1) / arena_.window_bytes, count_);
    if (first >= last) continue;
    if (obstacle.weight == Obstacle::forbids) {
      ++edges[first].forbidding;
      --edges[last].forbidding;
    } else {
      edges[first].weight += obstacle.weight;
      edges[last].less += obstacle.weight;
    }
  }
  std::optional<Choice> low, high;  // low: before start_; high: from start_ on
  std::uint64_t weight = 0;
  std::int64_t forbidding = 0;
  for (auto edge = edges.begin(); edge->first < count_; ++edge) {
    weight += edge->second.weight;
    weight -= edge->second.less;
    forbidding += edge->second.forbidding;
    std::optional<Choice>& best = edge->first < start_ ? low : high;
    if (forbidding != 0 || (best && best->weight <= weight)) continue;
    const auto window = lowest_free(edge->first, std::next(edge)->first);
    if (window) best = Choice{arena_.base + *window * arena_.window_bytes, weight};
  }
  return !high || (low && low->weight < high->weight) ? low : high;
}

std::optional<AddressPlan::Choice> AddressPlan::take(std::span<const Obstacle> obstacles) {
  const auto choice = best(obstacles);
  if (choice) used_.insert((choice->base - arena_.base) / arena_.window_bytes);
  return choice;
}

bool AddressPlan::adopt(std::uint64_t base) {
  if (base < arena_.base || (base - arena_.base) % arena_.window_bytes != 0) return false;
  const std::uint64_t window = (base - arena_.base) / arena_.window_bytes;
  return window < count_ && used_.insert(window).second;
}

bool AddressPlan::give_back(std::uint64_t base) {
  if (base < arena_.base || (base - arena_.base) % arena_.window_bytes != 0) return false;
  return used_.erase((base - arena_.base) / arena_.window_bytes) == 1;
}

}  // namespace agnocast::daemon
