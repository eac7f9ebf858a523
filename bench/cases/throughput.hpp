// SPDX-License-Identifier: Apache-2.0
//
// What the parts of the case throughput share: its systems and its roles (throughput_roles.cpp).
//
// Peers are the systems of all cases. Agnocast and the floors are others of the same names: agnocast with messages that
// are plain bytes, as iceoryx has them; floors that can hold many messages at once.
#pragma once

#include <bench/system.hpp>

#include <string_view>
#include <vector>

namespace agnocast::bench::throughput {

/// All that this build has, in the order of the tables.
const std::vector<System>& systems();
/// Throws std::runtime_error.
const System& find(std::string_view name);

std::vector<System> ring_systems();      // throughput_rings.cpp
std::vector<System> agnocast_systems();  // throughput_agnocast.cpp

/// The sizes that there are message types for.
inline constexpr std::size_t small_bytes = 64;
inline constexpr std::size_t large_bytes = std::size_t{1} << 20;

inline constexpr std::string_view sender_role = "throughput-sender";
inline constexpr std::string_view receiver_role = "throughput-receiver";

}  // namespace agnocast::bench::throughput
