// SPDX-License-Identifier: Apache-2.0
//
// What the library's thread of one node does: it runs the callbacks while it is their host, waits
// while an executor is, and ends with the node's last callback.
#pragma once

#include <client/executors/node_callbacks.hpp>
#include <client/executors/sleep_tick.hpp>

#include <cstdint>

namespace agnocast {

/// How serve() knows what its epoll set reports.
inline constexpr std::uint64_t eventfd_tag = 0, datagram_tag = 1, tick_tag = 2;

/// Host: the address of `node`. Returns after node.stop(), or when exit handlers have begun. `epoll` has
/// the node's bells and `tick`, by their tags.
void serve(NodeCallbacks& node, int epoll, const SleepTick& tick) noexcept;

}  // namespace agnocast
