// SPDX-License-Identifier: Apache-2.0
//
// Why a publisher stopped serving a subscription (docs/protocol.md, withdrawing), as a name and
// as a sentence: the daemon's log, the flight recorder and agnocast-ctl use the same words.
#pragma once

#include <agnocast/abi/words.hpp>

namespace agnocast::journal {

/// Returns the name in docs/protocol.md: "over_share".
constexpr const char* name_of(abi::Withdrawal why) noexcept {
  switch (why) {
    case abi::Withdrawal::none:
      return "none";
    case abi::Withdrawal::over_quota:
      return "over_quota";
    case abi::Withdrawal::over_share:
      return "over_share";
    case abi::Withdrawal::not_attached:
      return "not_attached";
  }
  return "unknown";
}

/// Returns a sentence about the subscription: "its user kept too much of the heap".
constexpr const char* sentence_of(abi::Withdrawal why) noexcept {
  switch (why) {
    case abi::Withdrawal::over_quota:
      return "it held more messages than it may";
    case abi::Withdrawal::over_share:
      return "its user kept too much of the heap";
    case abi::Withdrawal::not_attached:
      return "its process could not be mapped";
    case abi::Withdrawal::none:
      break;
  }
  return "there is no reason";
}

}  // namespace agnocast::journal
