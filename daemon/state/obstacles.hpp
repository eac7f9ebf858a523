// SPDX-License-Identifier: Apache-2.0
//
// Obstacles: mappings that processes have where heap windows lie (a JIT, a GPU's addresses), as
// each process reports them. Pure.
//
// A claim always holds for the process that makes it: no window is opened for it there, and it
// cannot reach what others have there. For all other processes it is a wish: new windows avoid the
// range while others are free, and the daemon may ask a heap to move. So that no user can make the
// daemon avoid the whole arena, the claims of one user count for others only up to half of the
// arena and ranges_per_user_max different ranges, the earliest first; later claims hold for their
// own process alone. Not in the redo log: each process that reconnects reports its claims again.
#pragma once

#include <agnocast/result.hpp>
#include <daemon/state/address_plan.hpp>
#include <daemon/state/tables.hpp>

#include <cstdint>
#include <map>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

namespace agnocast::daemon {

class Obstacles {
 public:
  // Processes of one user have the same libraries at the same places, which count once.
  static constexpr std::size_t ranges_per_user_max = 64;

  struct Claim {
    std::uint64_t base = 0;
    std::uint64_t bytes = 0;
    std::string what;    // for people: what is mapped there
    bool counts = true;  // for other processes too
  };

  explicit Obstacles(const Arena& arena) noexcept : arena_(arena) {}

  /// Adds a claim of a process; a repeated one changes nothing. Errors: protocol_violation (not in
  /// the arena, or one too many).
  [[nodiscard]] Result<void> add(ClientIndex client, std::uint32_t uid, std::uint64_t base,
                                 std::uint64_t bytes, std::string what);
  /// Removes the claims of a process that is gone.
  void forget(ClientIndex client);

  /// Returns the claim of the process that overlaps this window; null if there is none.
  const Claim* in_the_way(ClientIndex client, const WindowRecord& window) const;
  /// Returns the claims of a process in the order of their reports.
  const std::vector<Claim>& of(ClientIndex client) const;
  /// Returns the obstacles to a window of this process.
  std::vector<Obstacle> against(ClientIndex client) const;

 private:
  using Range = std::pair<std::uint64_t, std::uint64_t>;  // first window, and one past the last
  struct Process {
    std::uint32_t uid = 0;
    std::vector<Claim> claims;
  };
  Range windows_of(std::uint64_t base, std::uint64_t bytes) const noexcept;
  bool may_count(const std::map<Range, std::uint64_t>& counted, const Range& range) const;

  Arena arena_;
  std::unordered_map<std::uint32_t, Process> processes_;  // by client index
  // By uid: ranges that count for others, and how many processes claim each.
  std::unordered_map<std::uint32_t, std::map<Range, std::uint64_t>> counted_;
};

}  // namespace agnocast::daemon
