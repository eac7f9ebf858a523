// SPDX-License-Identifier: Apache-2.0
//
// Reaper: ends what may take its time. Deleting a reliable DDS writer waits up to a second for readers that have not
// acknowledged, and a bridge has many to delete when a host vanishes; nobody else shall wait for that.
#pragma once

#include <bridge/common/worker.hpp>

#include <memory>
#include <new>
#include <utility>

namespace agnocast::bridge {

/// Any thread. It is gone when everything has ended.
class Reaper {
 public:
  /// Lets go of it, in a while; at once if there is no memory.
  void end(std::shared_ptr<void> thing) noexcept try {
    worker_.add([held = std::move(thing)] { return false; });
  } catch (const std::bad_alloc&) {
  }

 private:
  Worker worker_;
};

}  // namespace agnocast::bridge
