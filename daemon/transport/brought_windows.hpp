// SPDX-License-Identifier: Apache-2.0
//
// Windows that a process brings from a former incarnation.
//
// A process brings what it has from a former incarnation before it asks this one for anything.
// Until then the kernel lets descriptors through to the daemon.
#pragma once

#include <daemon/transport/connection_table.hpp>

namespace agnocast::daemon {

void expect_windows(Peer& peer);
/// Has the kernel refuse descriptors again, if it does not.
void expect_no_windows(Peer& peer);

}  // namespace agnocast::daemon
