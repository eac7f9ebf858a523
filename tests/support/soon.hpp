// SPDX-License-Identifier: Apache-2.0
//
// A bounded wait for conditions that run programs or take their time, unlike eventually()
// (processes/daemon_process.hpp), which counts its rounds.
#pragma once

#include <chrono>
#include <thread>

namespace agnocast::test {

/// Runs `condition` repeatedly until it holds; false if it does not within the patience.
template <class Condition>
[[nodiscard]] bool soon(Condition condition,
                        std::chrono::milliseconds patience = std::chrono::seconds(20)) {
  const auto end = std::chrono::steady_clock::now() + patience;
  while (std::chrono::steady_clock::now() < end) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return condition();
}

}  // namespace agnocast::test
