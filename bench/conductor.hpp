// SPDX-License-Identifier: Apache-2.0
//
// Conductor: carries one run of one system out: starts the processes, waits until they know each other, lets them go, and
// gives back what the lane has kept. role.cpp is what the processes do.
#pragma once

#include <bench/lane.hpp>
#include <bench/services.hpp>
#include <bench/system.hpp>

#include <chrono>
#include <cstdint>
#include <vector>

namespace agnocast::bench {

/// Nanoseconds, without the messages of the warm-up.
struct Times {
  std::vector<double> publish_ns;  ///< the publish call
  std::vector<std::vector<double>>
      latency_ns;                ///< of each receiver: from before the call to the message in hand
  double sender_cpu_ns = 0;      ///< of a message: of the sender's process, all that it does
  bool is_without_fifo = false;  ///< real-time scheduling was wanted and refused

  /// Of the slowest receiver of each message.
  std::vector<double> slowest_ns() const;
};

/// conduct() gives up after no more than this.
std::chrono::seconds longest_of(const Plan& plan);

/// Throws std::runtime_error with what went wrong: a message that was lost or changed, a process that ended, no match.
Times conduct(const System& system, const Plan& plan, Services& services);

/// The same for a sender and receivers with a life of their own (throughput): starts the role `sender` and
/// `plan.receivers` times the role `receiver`, each with the lane's descriptor as its first and, for receivers, its index as
/// its second argument, and returns when all have ended with status 0.
void conduct_roles(const System& system, Lane& lane, Services& services, std::string_view sender,
                   std::string_view receiver);

// --- for such roles

/// What System's makers want, from a lane and the descriptors that were inherited.
Carriage carriage_of(const Lane& lane, std::size_t index);
/// By the name in the lane.
const System& system_of(const Lane& lane);
/// Pins the calling thread, and those that it starts, as the plan says, and makes it real-time where it is to be and may
/// be. Before the side is made. Spinning receivers stay ordinary: the kernel stops a real-time thread that never sleeps.
void take_place(const Lane& lane, const System& system, bool is_sender);
/// Becomes the user that the plan wants.
void become_receiver_user(const Lane& lane);

}  // namespace agnocast::bench
