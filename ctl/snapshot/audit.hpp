// SPDX-License-Identifier: Apache-2.0
//
// Audit: one look at the whole system for broken invariants (journal/verify.hpp).
//
// Nobody stops for it, so what it finds may be an operation under way: a hold that is set before the
// cursor moves, a line half unlinked, a board that is newer than the dump. Each finding carries the
// words that are wrong; who calls this looks several times and believes only what every look found
// with the same words. A queue is copied while its publisher does not move and checked in the copy;
// of one that never rests only what always holds is checked, and counted: such a look says nothing
// about what can be seen at rest only.
#pragma once

#include <ctl/snapshot/system.hpp>
#include <journal/verify.hpp>

#include <array>
#include <cstdint>
#include <set>
#include <string>
#include <tuple>

namespace agnocast::ctl {

struct Finding {
  journal::Invariant invariant = journal::Invariant::none;
  std::string where;
  std::array<std::uint64_t, 3> words{};
  bool seen_at_rest = false;  // in a queue, and it cannot be seen in one that moves
  friend bool operator<(const Finding& a, const Finding& b) {
    return std::tie(a.where, a.invariant, a.words) < std::tie(b.where, b.invariant, b.words);
  }
};

struct Audit {
  std::set<Finding> findings;
  std::set<std::string> in_motion;  // queues that could be checked in part only
  std::uint64_t queues = 0;         // checked at rest
  std::uint64_t links = 0;
};

Audit audit(const System& system, std::uint64_t client_region_bytes);

/// Forgets what a later look shows to be over.
void keep_what_lasts(std::set<Finding>& findings, const Audit& later);

}  // namespace agnocast::ctl
