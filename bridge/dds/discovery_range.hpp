// SPDX-License-Identifier: Apache-2.0
//
// How far nodes of ROS 2 look for each other: the variables ROS_LOCALHOST_ONLY,
// ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS, as a configuration of Cyclone DDS. The bridge
// is found by those who find each other, and by no others.
#pragma once

#include <tl/expected.hpp>

#include <functional>
#include <string>

namespace agnocast::bridge {

/// What the variables ask for.
struct DiscoveryRange {
  std::string configuration;  ///< for Cyclone DDS, before CYCLONEDDS_URI's; empty: its defaults
  std::string reason;         ///< the variable that limits the range, for the log; else empty
};
struct DiscoveryRangeError {
  std::string variable, what, remedy;
};

/// Reads the variables with `variable`, which returns "" for one that is not set.
///
/// ROS_LOCALHOST_ONLY=1 is Humble's: its nodes use the loopback device alone. Newer distributions
/// (ROS_DISTRO) take it for ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, where nodes use all devices
/// but look for others on this host only. With it, and with SYSTEM_DEFAULT and OFF,
/// ROS_STATIC_PEERS does not count.
[[nodiscard]] tl::expected<DiscoveryRange, DiscoveryRangeError> discovery_range(
    const std::function<std::string(const char*)>& variable);

}  // namespace agnocast::bridge
