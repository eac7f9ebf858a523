// SPDX-License-Identifier: Apache-2.0
//
// ReaderNotes: how many records about readers of one user another one may cause. Pure; time is
// told.
//
// They change nothing, and they lie in the ring that recovery needs and the flight recorder shows.
// A publisher can say as often as it likes that it serves a reader no more and again; so each pair
// of users has some at once and then one a minute, and what is beyond is only counted. They are no
// evidence: creations push them out of the ring like any record.
#pragma once

#include <daemon/transport/allowance.hpp>

#include <cstdint>
#include <map>
#include <utility>

namespace agnocast::daemon {

class ReaderNotes {
 public:
  // A publisher withdraws all readers of a user in one look. 32 + 60 in an hour, of the 4096
  // records of the ring.
  static constexpr std::uint64_t at_once = 32;
  static constexpr std::uint64_t interval_ms = 60'000;

  /// A process of `teller` says something of a reader of `reader`; the daemon itself finds
  /// something in the name of the reader's user. False: no record now.
  bool take(std::uint32_t teller, std::uint32_t reader, std::uint64_t now_ms) {
    return users_.try_emplace({teller, reader}, at_once, interval_ms).first->second.take(now_ms);
  }
  /// Of users who have caused none for long.
  void forget_unused(std::uint64_t now_ms) {
    std::erase_if(users_, [&](const auto& one) { return one.second.is_whole(now_ms); });
  }

 private:
  // By both uids: one user's withdrawn readers leave those of another user their records.
  std::map<std::pair<std::uint32_t, std::uint32_t>, Allowance> users_;
};

}  // namespace agnocast::daemon
