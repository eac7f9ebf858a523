// SPDX-License-Identifier: Apache-2.0
//
// Converts QoS of the public interface to the words of the board.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/words.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/result.hpp>

#include <chrono>
#include <cstdint>
#include <string>

namespace agnocast {

inline abi::Qos to_abi(const QoS& qos) noexcept {
  const auto time = [](std::chrono::nanoseconds value) {
    return static_cast<std::uint64_t>(value.count());
  };
  return {static_cast<std::uint32_t>(qos.depth()),
          qos.is_transient_local(),
          qos.is_reliable(),
          qos.is_keep_all(),
          false,
          qos.liveliness() == Liveliness::manual_by_topic,
          time(qos.deadline()),
          time(qos.lifespan()),
          time(qos.liveliness_lease_duration())};
}

// Checks the times, and the capacity of a queue; the daemon's own limit may be lower.
inline Result<void> check_qos(const QoS& qos) {
  if (qos.depth() < 1 || qos.depth() > abi::depth_max)
    return fail_with(Errc::depth_refused, "depth " + std::to_string(qos.depth()) +
                                              " is outside 1 to " + std::to_string(abi::depth_max));
  const auto check = [](const char* what, std::chrono::nanoseconds time) -> Result<void> {
    if (time.count() >= 0) return {};
    return fail_with(Errc::invalid_argument, std::string("the ") + what + " of " +
                                                 std::to_string(time.count()) + " ns is negative");
  };
  Result<void> fits = check("deadline", qos.deadline());
  if (fits) fits = check("lifespan", qos.lifespan());
  if (fits) fits = check("liveliness lease", qos.liveliness_lease_duration());
  return fits;
}

}  // namespace agnocast
