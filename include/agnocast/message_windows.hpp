// SPDX-License-Identifier: Apache-2.0
//
// Where a received message may lie with all that it leads to. For a relay, which does not trust its publisher
// (relay.hpp), and for publish, which may be given such a message.
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/residency.hpp>

namespace agnocast {

namespace detail {
AGNOCAST_PUBLIC WindowSet windows_of(const Block* block) noexcept;
/// The same of an object of whatever kind by its address alone. Empty: it does not lie in another process's
/// window, as most do not; that costs a comparison.
AGNOCAST_PUBLIC WindowSet windows_of_another(const void* object) noexcept;
}  // namespace detail

/// Memory of its publisher that this process can read, of the windows that one message may be spread over. Empty
/// for a loan. Any thread; no system call. Valid as long as the message is held.
template <class T>
WindowSet windows_of(const ipc_shared_ptr<T>& message) noexcept {
  return detail::windows_of(message.block());
}

}  // namespace agnocast
