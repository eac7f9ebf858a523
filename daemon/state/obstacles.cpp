// SPDX-License-Identifier: Apache-2.0

#include <daemon/state/obstacles.hpp>

#include <base/check.hpp>

#include <algorithm>

namespace agnocast::daemon {

Obstacles::Range Obstacles::windows_of(std::uint64_t base, std::uint64_t bytes) const noexcept {
  const std::uint64_t begin = base - arena_.base;
  return {begin / arena_.window_bytes,
          (begin + bytes + arena_.window_bytes - 1) / arena_.window_bytes};
}

// Returns whether this user's counting windows, with these, are at most half of the arena.
bool Obstacles::may_count(const std::map<Range, std::uint64_t>& counted, const Range& range) const {
  if (counted.count(range) != 0) return true;
  if (counted.size() >= ranges_per_user_max) return false;
  std::vector<Range> all{range};
  for (const auto& [other, processes] : counted) all.push_back(other);
  std::sort(all.begin(), all.end());
  std::uint64_t windows = 0, end = 0;
  for (const Range& one : all) {
    if (one.second <= end) continue;
    windows += one.second - std::max(one.first, end);
    end = one.second;
  }
  return windows <= arena_.bytes / arena_.window_bytes / 2;
}

Result<void> Obstacles::add(ClientIndex client, std::uint32_t uid, std::uint64_t base,
                            std::uint64_t bytes, std::string what) {
  if (bytes == 0 || base < arena_.base || bytes > arena_.bytes ||
      base - arena_.base > arena_.bytes - bytes)
    return fail(Errc::protocol_violation, "a blocked range is not in the arena");
  Process& process = processes_[number(client)];
  process.uid = uid;
  const bool known =
      std::any_of(process.claims.begin(), process.claims.end(),
                  [&](const Claim& claim) { return claim.base == base && claim.bytes == bytes; });
  if (known) return {};
  if (process.claims.size() >= abi::blocked_count_max)
    return fail(Errc::protocol_violation, "too many blocked ranges");
  const Range range = windows_of(base, bytes);
  const auto counted = counted_.find(uid);
  const bool counts = may_count(
      counted != counted_.end() ? counted->second : std::map<Range, std::uint64_t>(), range);
  if (counts) ++counted_[uid][range];
  process.claims.push_back({base, bytes, std::move(what), counts});
  return {};
}

void Obstacles::forget(ClientIndex client) {
  const auto found = processes_.find(number(client));
  if (found == processes_.end()) return;
  for (const Claim& claim : found->second.claims) {
    if (!claim.counts) continue;
    // A user whose claims hold only for their own processes has no entry.
    const auto user = counted_.find(found->second.uid);
    AGNOCAST_CHECK(user != counted_.end());
    const auto range = user->second.find(windows_of(claim.base, claim.bytes));
    AGNOCAST_CHECK(range != user->second.end());
    if (--range->second == 0) user->second.erase(range);
    if (user->second.empty()) counted_.erase(user);
  }
  processes_.erase(found);
}

const Obstacles::Claim* Obstacles::in_the_way(ClientIndex client,
                                              const WindowRecord& window) const {
  for (const Claim& claim : of(client)) {
    if (claim.base < window.base + window.bytes && window.base < claim.base + claim.bytes)
      return &claim;
  }
  return nullptr;
}

const std::vector<Obstacles::Claim>& Obstacles::of(ClientIndex client) const {
  static const std::vector<Claim> none;
  const auto found = processes_.find(number(client));
  return found != processes_.end() ? found->second.claims : none;
}

std::vector<Obstacle> Obstacles::against(ClientIndex client) const {
  std::vector<Obstacle> all;
  for (const Claim& claim : of(client)) all.push_back({claim.base, claim.bytes, Obstacle::forbids});
  for (const auto& [uid, ranges] : counted_) {
    for (const auto& [range, processes] : ranges)
      all.push_back({arena_.base + range.first * arena_.window_bytes,
                     (range.second - range.first) * arena_.window_bytes, processes});
  }
  return all;
}

}  // namespace agnocast::daemon
