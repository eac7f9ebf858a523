// SPDX-License-Identifier: Apache-2.0
//
// Memory that may contain a received message and everything it refers to. For a relay, which does
// not trust the publisher (relay.hpp), and for publish, which may be given such a message.
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/residency.hpp>

namespace agnocast {

namespace detail {
AGNOCAST_PUBLIC WindowSet windows_of(const Block* block) noexcept;
/// The same for any object, by its address alone. Empty if the object is not in another process's
/// window, the usual case, which costs one comparison.
AGNOCAST_PUBLIC WindowSet windows_of_another(const void* object) noexcept;
}  // namespace detail

/// Returns the memory of its publisher that this process maps: the windows of its window set.
/// Empty for a loan. Any thread; no system call. Valid as long as the message is held.
template <class T>
WindowSet windows_of(const ipc_shared_ptr<T>& message) noexcept {
  return detail::windows_of(message.block());
}

}  // namespace agnocast
