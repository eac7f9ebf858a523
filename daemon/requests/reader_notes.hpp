// SPDX-License-Identifier: Apache-2.0
//
// ReaderNotes: how many records about readers one user may cause. Pure; time is told.
//
// They change nothing, and they lie in the ring that recovery needs and the flight recorder shows. A publisher can say
// as often as it likes that it serves a reader no more and again; so each user has some at once and then one a
// minute, and what is beyond is only counted.
#pragma once

#include <daemon/transport/allowance.hpp>

#include <cstdint>
#include <unordered_map>

namespace agnocast::daemon {

class ReaderNotes {
 public:
  // A publisher withdraws all readers of a user in one look. 32 + 60 in an hour, of the 4096 records of the ring.
  static constexpr std::uint64_t at_once = 32;
  static constexpr std::uint64_t interval_ms = 60'000;

  /// False: no record now.
  bool take(std::uint32_t uid, std::uint64_t now_ms) {
    return users_.try_emplace(uid, at_once, interval_ms).first->second.take(now_ms);
  }
  /// Of users who have caused none for long.
  void forget_unused(std::uint64_t now_ms) {
    std::erase_if(users_, [&](const auto& one) { return one.second.is_whole(now_ms); });
  }

 private:
  std::unordered_map<std::uint32_t, Allowance> users_;  // by uid
};

}  // namespace agnocast::daemon
