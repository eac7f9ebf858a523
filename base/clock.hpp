// SPDX-License-Identifier: Apache-2.0
//
// Clock: the one time that all processes of the host share and no one can set.
#pragma once

#include <cstdint>
#include <ctime>

namespace agnocast {

/// Returns CLOCK_MONOTONIC in nanoseconds.
inline std::uint64_t monotonic_ns() noexcept {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<std::uint64_t>(now.tv_sec) * 1'000'000'000 +
         static_cast<std::uint64_t>(now.tv_nsec);
}
/// The same in milliseconds.
inline std::uint64_t monotonic_ms() noexcept { return monotonic_ns() / 1'000'000; }

}  // namespace agnocast
