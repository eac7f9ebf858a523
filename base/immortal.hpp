// SPDX-License-Identifier: Apache-2.0
//
// Immortal objects: one per process, never destroyed, because statics of the user, their
// destructors and other threads use it while exit handlers run. Static storage, because the first
// call may be where nothing may throw.
#pragma once

#include <cstddef>
#include <new>
#include <type_traits>

namespace agnocast {

/// Returns the only T; any thread.
template <class T>
T& immortal() noexcept {
  static_assert(std::is_nothrow_default_constructible_v<T>);
  alignas(T) static std::byte place[sizeof(T)];
  static T* const only = ::new (static_cast<void*>(place)) T;
  return *only;
}

}  // namespace agnocast
