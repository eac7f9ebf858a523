// SPDX-License-Identifier: Apache-2.0
//
// What a process has one of and never destroys: statics of the user, their destructors and other threads use it while
// exit handlers run. It lies in place, since who asks first may be where nothing can be thrown.
#pragma once

#include <cstddef>
#include <new>
#include <type_traits>

namespace agnocast {

/// The one T; any thread.
template <class T>
T& immortal() noexcept {
  static_assert(std::is_nothrow_default_constructible_v<T>);
  alignas(T) static std::byte place[sizeof(T)];
  static T* const only = ::new (static_cast<void*>(place)) T;
  return *only;
}

}  // namespace agnocast
