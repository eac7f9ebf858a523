// SPDX-License-Identifier: Apache-2.0
//
// What the roles of a run share, beside the lane: how a process finds its system and takes its
// place. role.cpp has the roles "sender" and "receiver", and lists the steps of a run.
#pragma once

#include <bench/lane.hpp>
#include <bench/system.hpp>

#include <cstddef>
#include <string_view>

namespace agnocast::bench {

/// The variable that names the descriptors of System::descriptors() to the processes of a run.
inline constexpr std::string_view descriptors_variable = "AGNOCAST_BENCH_DESCRIPTORS";

/// Makes the argument of System's makers from a lane and the inherited descriptors.
Carriage carriage_of(const Lane& lane, std::size_t index);
/// Returns the system named in the lane.
const System& system_of(const Lane& lane);
/// Pins the calling thread, and threads it starts, as the plan requires, and makes it real-time
/// if required and permitted. Call it before the side is made. Polling receivers stay ordinary:
/// the kernel stops a real-time thread that never sleeps.
void take_place(const Lane& lane, const System& system, bool is_sender);
/// Becomes the user that the plan requires.
void become_receiver_user(const Lane& lane);

}  // namespace agnocast::bench
