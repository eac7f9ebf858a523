// SPDX-License-Identifier: Apache-2.0
//
// Audit: one check of the whole system for broken invariants (journal/verify.hpp).
//
// No process stops for it, so a finding may be an operation in progress: a hold set before the
// cursor moves, a line half unlinked, a board newer than the dump. Each finding carries the wrong
// words; the caller audits several times and believes only findings that every audit made with the
// same words. A queue is copied and checked while its publisher is at rest. If the publisher never
// rests, only the invariants that always hold are checked, and the queue is listed in `in_motion`:
// that audit proves nothing about the others.
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
  bool seen_at_rest = false;  // visible only in a queue at rest
  friend bool operator<(const Finding& a, const Finding& b) {
    return std::tie(a.where, a.invariant, a.words) < std::tie(b.where, b.invariant, b.words);
  }
};

struct Audit {
  std::set<Finding> findings;
  std::set<std::string> in_motion;  // queues that were only partly checked
  std::uint64_t queues = 0;         // checked at rest
  std::uint64_t links = 0;
};

Audit audit(const System& system, std::uint64_t client_region_bytes);

/// Removes the findings that a later audit does not confirm.
void keep_what_lasts(std::set<Finding>& findings, const Audit& later);

}  // namespace agnocast::ctl
