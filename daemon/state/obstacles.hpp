// SPDX-License-Identifier: Apache-2.0
//
// Obstacles: what processes have where heap windows lie (a JIT, a GPU's addresses), as each says
// for itself. Pure.
//
// A claim always holds for the process that makes it: no window is opened for it there, and what
// others have there is unreachable for it. For everybody else it is a wish: new windows avoid it
// while others are free, and a heap may be asked to move. So that nobody has the whole arena
// avoided, the claims of one user count for others only up to half of the arena and
// ranges_per_user_max different ranges, the earliest first; what is beyond holds for its own
// process alone. Not journaled: whoever comes back says it again.
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
  // Processes of one user have the same libraries in the same places, and those count once.
  static constexpr std::size_t ranges_per_user_max = 64;

  struct Claim {
    std::uint64_t base = 0;
    std::uint64_t bytes = 0;
    std::string what;    // for people
    bool counts = true;  // for others
  };

  explicit Obstacles(const Arena& arena) noexcept : arena_(arena) {}

  /// A claim of a process; the same one again changes nothing. Errors: protocol_violation (not in
  /// the arena, or one too many).
  [[nodiscard]] Result<void> add(ClientIndex client, std::uint32_t uid, std::uint64_t base,
                                 std::uint64_t bytes, std::string what);
  /// The process is gone.
  void forget(ClientIndex client);

  /// What the process has in this range; null if nothing.
  const Claim* in_the_way(ClientIndex client, const WindowRecord& window) const;
  /// In order of their being said; empty if there is none.
  const std::vector<Claim>& of(ClientIndex client) const;
  /// Where a window for this process may lie.
  std::vector<Obstacle> against(ClientIndex client) const;

 private:
  using Range = std::pair<std::uint64_t, std::uint64_t>;  // windows, from and to
  struct Process {
    std::uint32_t uid = 0;
    std::vector<Claim> claims;
  };
  Range windows_of(std::uint64_t base, std::uint64_t bytes) const noexcept;
  bool may_count(const std::map<Range, std::uint64_t>& counted, const Range& range) const;

  Arena arena_;
  std::unordered_map<std::uint32_t, Process> processes_;  // by client index
  // By uid: what counts for others, and how many processes claim it.
  std::unordered_map<std::uint32_t, std::map<Range, std::uint64_t>> counted_;
};

}  // namespace agnocast::daemon
