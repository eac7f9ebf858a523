// SPDX-License-Identifier: Apache-2.0
//
// Common parts of the case throughput: its systems and its roles (throughput_roles.cpp).
//
// Peers are the systems of all cases. Agnocast and the floors are different ones of the same
// names: agnocast with messages of plain bytes, as in iceoryx; floors that can hold many messages
// at once.
#pragma once

#include <bench/system.hpp>

#include <string_view>
#include <vector>

namespace agnocast::bench::throughput {

/// Returns all systems of this build, in the order of the tables.
const std::vector<System>& systems();
/// Returns a system by name. Throws std::runtime_error.
const System& find(std::string_view name);

std::vector<System> ring_systems();      // throughput_rings.cpp
std::vector<System> agnocast_systems();  // throughput_agnocast.cpp

/// The sizes with a message type.
inline constexpr std::size_t small_bytes = 64;
inline constexpr std::size_t large_bytes = std::size_t{1} << 20;

inline constexpr std::string_view sender_role = "throughput-sender";
inline constexpr std::string_view receiver_role = "throughput-receiver";

}  // namespace agnocast::bench::throughput
