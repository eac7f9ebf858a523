// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace agnocast {

/// DDS has ports for domains up to this one (RTPS 2.3, 9.6.1.1), and ROS has the same limit.
inline constexpr std::uint32_t domain_max = 232;

}  // namespace agnocast
