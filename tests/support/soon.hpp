// SPDX-License-Identifier: Apache-2.0
//
// A bounded wait for conditions that run programs or take their time, unlike eventually()
// (processes/daemon_process.hpp), which counts its rounds.
#pragma once

#include <chrono>
#include <thread>

namespace agnocast::test {

/// Runs `condition` repeatedly until it holds; false if it does not within five minutes, which only
/// a test that fails takes: beside others on a slow machine, what takes a second alone takes 60.
template <class Condition>
[[nodiscard]] bool soon(Condition condition) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(5);
  while (std::chrono::steady_clock::now() < end) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  return condition();
}

}  // namespace agnocast::test
