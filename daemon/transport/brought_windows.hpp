// SPDX-License-Identifier: Apache-2.0
//
// Windows that a process brings from a previous incarnation.
//
// A process brings them before it sends this incarnation any other request. Until then the kernel
// lets descriptors through to the daemon.
#pragma once

#include <daemon/transport/connection_table.hpp>

namespace agnocast::daemon {

void expect_windows(Peer& peer);
/// Makes the kernel refuse descriptors again, if it does not.
void expect_no_windows(Peer& peer);

}  // namespace agnocast::daemon
