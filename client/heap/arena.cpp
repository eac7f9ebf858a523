// SPDX-License-Identifier: Apache-2.0

#include <client/heap/arena.hpp>

#include <algorithm>
#include <cerrno>
#include <cinttypes>
#include <cstdio>
#include <utility>

namespace agnocast {
namespace {

constexpr std::uint64_t granule = abi::window_granule_bytes;

// Another thread may map something between the search and the reservation.
constexpr int rounds_max = 8;

std::string hexadecimal(std::uint64_t begin, std::uint64_t end) {
  char text[48];
  std::snprintf(text, sizeof text, "0x%" PRIx64 "-0x%" PRIx64, begin, end);
  return text;
}

/// Returns the mappings inside [base, base + bytes) from /proc/self/maps: granules, in order,
/// adjacent ones joined.
std::vector<Arena::Blocked> what_lies_in(std::uint64_t base, std::uint64_t bytes) {
  std::vector<Arena::Blocked> found;
  std::FILE* const maps = std::fopen("/proc/self/maps", "re");
  if (maps == nullptr) return found;
  char line[512];
  bool is_whole = true;  // false: the next read continues a long line
  while (std::fgets(line, sizeof line, maps) != nullptr) {
    std::string text = line;
    const bool begins = std::exchange(is_whole, text.back() == '\n');
    std::uint64_t begin = 0, end = 0;
    if (!begins || std::sscanf(line, "%" SCNx64 "-%" SCNx64, &begin, &end) != 2) continue;
    if (end <= base || begin >= base + bytes) continue;
    while (!text.empty() && (text.back() == '\n' || text.back() == ' ')) text.pop_back();
    begin = std::max(begin, base) / granule * granule;
    end = std::min((end + granule - 1) / granule * granule, base + bytes);
    if (!found.empty() && begin <= found.back().base + found.back().bytes) {
      found.back().bytes = std::max(found.back().bytes, end - found.back().base);
    } else {
      found.push_back({begin, end - begin, std::move(text)});
    }
  }
  std::fclose(maps);
  return found;
}

}  // namespace

Result<Arena> Arena::reserve(std::uint64_t base, std::uint64_t bytes) {
  Arena arena;
  arena.base_ = base;
  arena.bytes_ = bytes;
  for (int round = 0; round < rounds_max; ++round) {
    // Usually nothing is in the way.
    if (round > 0) arena.blocked_ = what_lies_in(base, bytes);
    std::vector<Blocked>& blocked = arena.blocked_;
    // More than can be reported: the last one extends to the end.
    if (blocked.size() > abi::blocked_count_max) {
      blocked.resize(abi::blocked_count_max);
      blocked.back().bytes = base + bytes - blocked.back().base;
    }
    arena.reserved_.clear();
    std::uint64_t at = base;
    bool occupied = false;
    for (std::size_t i = 0; i <= blocked.size() && !occupied; ++i) {
      const std::uint64_t end = i < blocked.size() ? blocked[i].base : base + bytes;
      if (end > at) {
        Result<Mapping> part = Mapping::reserve(at, end - at);
        if (!part && part.error().os_errno != EEXIST) return tl::unexpected<Failure>(part.error());
        occupied = !part;
        if (part) arena.reserved_.push_back(std::move(*part));
      }
      if (i < blocked.size()) at = blocked[i].base + blocked[i].bytes;
    }
    if (occupied) continue;
    if (!arena.reserved_.empty()) return arena;
    break;
  }
  return fail_with(Errc::arena_occupied,
                   hexadecimal(base, base + bytes) + " has " +
                       (arena.blocked_.empty() ? "another mapping" : arena.blocked_.front().what));
}

bool Arena::contains(std::uint64_t base, std::uint64_t bytes) const noexcept {
  return base >= base_ && bytes <= bytes_ && base - base_ <= bytes_ - bytes;
}

bool Arena::has(std::uint64_t base, std::uint64_t bytes) const noexcept {
  return std::any_of(reserved_.begin(), reserved_.end(), [&](const Mapping& part) {
    const auto begin = reinterpret_cast<std::uint64_t>(part.base());
    return base >= begin && bytes <= part.bytes() && base - begin <= part.bytes() - bytes;
  });
}

}  // namespace agnocast
