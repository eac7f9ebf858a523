// SPDX-License-Identifier: Apache-2.0
//
// Sleeper: something of this process that sleeps until a publisher rings: a sleep word in the
// client region and two bells.
#pragma once

#include <base/doorbell.hpp>
#include <client/dataplane/subscription_core.hpp>

#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <utility>

namespace agnocast {

class Sleeper {
 public:
  Sleeper(std::byte* client_region, std::uint64_t index, DoorbellReceiver bells) noexcept
      : index_(index),
        bells_(std::move(bells)),
        core_(client_region,
              offsetof(abi::ClientRegionHeader, executor) + index * sizeof(abi::ExecutorLine)) {}

  std::uint64_t index() const noexcept { return index_; }
  const DoorbellReceiver& bells() const noexcept { return bells_; }
  /// Order: arm, look at every subscription, block on the bells, disarm. One thread.
  void arm() noexcept { core_.arm(); }
  void disarm() noexcept { core_.disarm(); }
  /// Ends the sleep from inside the process: a new link, a window, a publisher that is gone. Any
  /// thread.
  void wake() const noexcept {
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t written = ::write(bells_.eventfd(), &one, sizeof one);
  }

 private:
  std::uint64_t index_;
  DoorbellReceiver bells_;
  dataplane::SleepCore<SharedMemory> core_;
};

}  // namespace agnocast
