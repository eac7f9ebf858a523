// SPDX-License-Identifier: Apache-2.0
//
// Where a received message may lie with all that it leads to. For who does not trust its publisher
// (relay.hpp).
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/residency.hpp>

namespace agnocast {

namespace detail {
AGNOCAST_PUBLIC WindowSet windows_of(const Block* block) noexcept;
}  // namespace detail

/// Memory of its publisher that this process can read, of the windows that one message may be spread over. Empty
/// for a loan. Any thread; no system call. Valid as long as the message is held.
template <class T>
WindowSet windows_of(const ipc_shared_ptr<T>& message) noexcept {
  return detail::windows_of(message.block());
}

}  // namespace agnocast
