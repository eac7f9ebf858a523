// SPDX-License-Identifier: Apache-2.0
//
// ReaderNotes: limits the records about readers of one user that another user can cause. Pure; the
// caller passes the time.
//
// These records change nothing, and they lie in the ring that recovery needs and the flight
// recorder shows. A publisher can report as often as it likes that it withdraws from a reader and
// serves it again; so each pair of users has some records at once and then one a minute, and
// further ones are only counted. They are no evidence: creations push them out of the ring.
#pragma once

#include <daemon/transport/allowance.hpp>

#include <cstdint>
#include <map>
#include <utility>

namespace agnocast::daemon {

class ReaderNotes {
 public:
  // A publisher withdraws from all readers of a user in one look. 32 + 60 in an hour, of the 4096
  // records of the ring.
  static constexpr std::uint64_t at_once = 32;
  static constexpr std::uint64_t interval_ms = 60'000;

  /// Returns whether a report of a process of `teller` about a reader of `reader` gets a record
  /// now. A finding of the daemon counts as one of the reader's user.
  bool take(std::uint32_t teller, std::uint32_t reader, std::uint64_t now_ms) {
    return users_.try_emplace({teller, reader}, at_once, interval_ms).first->second.take(now_ms);
  }
  /// Forgets users that have caused none for long.
  void forget_unused(std::uint64_t now_ms) {
    std::erase_if(users_, [&](const auto& one) { return one.second.is_whole(now_ms); });
  }

 private:
  // By both uids: one user's withdrawn readers leave the records of another user's readers alone.
  std::map<std::pair<std::uint32_t, std::uint32_t>, Allowance> users_;
};

}  // namespace agnocast::daemon
