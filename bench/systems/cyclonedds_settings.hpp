// SPDX-License-Identifier: Apache-2.0
//
// Cyclone DDS's configuration as the variable CYCLONEDDS_URI, for every system that uses it: only
// the loopback interface, peers found without multicast, separate from other DDS traffic of this
// host; everything else is Cyclone's default.
#pragma once

#include <string>
#include <vector>

namespace agnocast::bench {

std::vector<std::string> cyclonedds_over_network();
/// The recommended settings for large messages: packets and fragments of 64 KB, as large as UDP
/// permits, instead of 14 and 1.3, and as much of a receive buffer as net.core.rmem_max allows.
std::vector<std::string> cyclonedds_tuned();
std::vector<std::string> cyclonedds_over_iceoryx();

}  // namespace agnocast::bench
