// SPDX-License-Identifier: Apache-2.0
//
// SlowDeleter: destroys objects that take time. Deleting a reliable DDS writer waits up to a second
// for readers that have not acknowledged, and when a host vanishes the bridge deletes many; no
// other thread may wait for that.
#pragma once

#include <bridge/common/worker.hpp>

#include <memory>
#include <new>
#include <utility>

namespace agnocast::bridge {

/// Any thread. Its destructor waits until everything has ended.
class SlowDeleter {
 public:
  /// Destroys `thing` soon on its thread; at once if there is no memory.
  void end(std::shared_ptr<void> thing) noexcept try {
    worker_.add([held = std::move(thing)] { return false; });
  } catch (const std::bad_alloc&) {
  }

 private:
  Worker worker_;
};

}  // namespace agnocast::bridge
