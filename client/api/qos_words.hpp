// SPDX-License-Identifier: Apache-2.0
//
// Converts QoS of the public interface to the words of the board.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/words.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/result.hpp>

#include <string>

namespace agnocast {

inline abi::Qos to_abi(const QoS& qos) noexcept {
  return {static_cast<std::uint32_t>(qos.depth()), qos.is_transient_local(), qos.is_reliable(),
          qos.is_keep_all(), false};
}

// Checks the capacity of a queue; the daemon's own limit may be lower.
inline Result<void> check_depth(const QoS& qos) {
  if (qos.depth() >= 1 && qos.depth() <= abi::depth_max) return {};
  return fail_with(Errc::depth_refused, "depth " + std::to_string(qos.depth()) +
                                            " is outside 1 to " + std::to_string(abi::depth_max));
}

}  // namespace agnocast
