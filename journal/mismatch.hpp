// SPDX-License-Identifier: Apache-2.0
//
// Why two endpoints do not match, as a sentence: the notices of the daemon and agnocast-ctl use the
// same words.
#pragma once

#include <agnocast/abi/words.hpp>

#include <cstdint>
#include <string>

namespace agnocast::journal {

/// "100 ms", "2500000 ns", or "none" for 0.
inline std::string time_text(std::uint64_t time_ns) {
  constexpr std::uint64_t ms = 1'000'000;
  if (time_ns == 0) return "none";
  return time_ns % ms == 0 ? std::to_string(time_ns / ms) + " ms" : std::to_string(time_ns) + " ns";
}

/// "reliable is requested, best effort is offered"; empty if they match.
inline std::string mismatch_text(const abi::Qos& offered, const abi::Qos& requested) {
  const auto times = [](const char* what, std::uint64_t wanted, std::uint64_t given) {
    return std::string(what) + " of " + time_text(wanted) + " is requested, " + time_text(given) +
           " is offered";
  };
  switch (abi::qos_mismatch(offered, requested)) {
    case abi::QosPolicy::none:
      break;
    case abi::QosPolicy::reliability:
      return "reliable is requested, best effort is offered";
    case abi::QosPolicy::durability:
      return "transient_local is requested, volatile is offered";
    case abi::QosPolicy::deadline:
      return times("a deadline", requested.deadline_ns, offered.deadline_ns);
    case abi::QosPolicy::liveliness:
      return "liveliness manual_by_topic is requested, automatic is offered";
    case abi::QosPolicy::liveliness_lease:
      return times("a liveliness lease", requested.lease_ns, offered.lease_ns);
  }
  return {};
}

}  // namespace agnocast::journal
