// SPDX-License-Identifier: Apache-2.0
//
// QoS of the public interface in the words of the board.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/words.hpp>
#include <agnocast/qos.hpp>
#include <agnocast/result.hpp>

namespace agnocast {

inline abi::Qos to_abi(const QoS& qos) noexcept {
  return {static_cast<std::uint32_t>(qos.depth()), qos.is_transient_local(), qos.is_reliable(),
          qos.is_keep_all(), false};
}

// The daemon's own limit may be lower; this one is what a queue can hold at all.
inline Result<void> check_depth(const QoS& qos) noexcept {
  if (qos.depth() == 0) return fail(Errc::depth_refused, "a history depth of 0");
  if (qos.depth() > abi::depth_max) return fail(Errc::depth_refused, "a history depth above 1000");
  return {};
}

}  // namespace agnocast
