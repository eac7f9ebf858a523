// SPDX-License-Identifier: Apache-2.0
//
// Maps a death or the end of a publisher to a counter of the daemon: the operation that plans the
// record computes the new value, the one that applies it stores that.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <journal/record.hpp>

#include <cstdint>

namespace agnocast::daemon {

inline std::uint64_t& death_counter(abi::wire::DaemonCounters& counters,
                                    journal::DeathReason reason) noexcept {
  switch (reason) {
    case journal::DeathReason::unmapped:
      return counters.clients_unmapped;
    case journal::DeathReason::revoked:
      return counters.clients_revoked;
    case journal::DeathReason::died:
      break;
  }
  return counters.clients_died;
}

inline std::uint64_t* intent_counter(abi::wire::DaemonCounters& counters,
                                     journal::LeaveCause cause) noexcept {
  switch (cause) {
    case journal::LeaveCause::rolled_back:
      return &counters.intents_rolled_back;
    case journal::LeaveCause::rolled_forward:
      return &counters.intents_rolled_forward;
    case journal::LeaveCause::corrupt:
      return &counters.intents_corrupt;
    case journal::LeaveCause::left:
    case journal::LeaveCause::nothing_open:
      break;
  }
  return nullptr;
}

}  // namespace agnocast::daemon
