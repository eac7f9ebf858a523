// SPDX-License-Identifier: Apache-2.0
//
// What the library's thread of one node does: it runs the callbacks while it is their host, waits
// while an executor is, and ends with the node's last callback.
#pragma once

#include <client/executors/node_callbacks.hpp>

namespace agnocast {

/// Host: the address of `node`. Returns after node.stop(), or when
/// exit handlers have begun. `epoll` has the node's bells, the
/// datagram socket with tag 1.
void serve(NodeCallbacks& node, int epoll) noexcept;

}  // namespace agnocast
