// SPDX-License-Identifier: Apache-2.0
//
// Conductor: runs one run of one system: starts the processes, waits until they have matched,
// starts the messages, and returns the times in the lane. role.cpp is the code of the processes.
#pragma once

#include <bench/lane.hpp>
#include <bench/services.hpp>
#include <bench/system.hpp>

#include <chrono>
#include <cstdint>
#include <vector>

namespace agnocast::bench {

/// Times in nanoseconds, without the messages of the warm-up.
struct Times {
  std::vector<double> publish_ns;  ///< the publish call
  std::vector<std::vector<double>>
      latency_ns;                ///< per receiver: from before the call until it has the message
  double sender_cpu_ns = 0;      ///< per message: of the sender's process, everything it does
  bool is_without_fifo = false;  ///< real-time scheduling was refused

  /// Returns the latency of the slowest receiver of each message.
  std::vector<double> slowest_ns() const;
};

/// Returns the time limit of conduct().
std::chrono::seconds longest_of(const Plan& plan);

/// Throws std::runtime_error with the failure: a lost or changed message, a process that ended,
/// no match.
Times conduct(const System& system, const Plan& plan, Services& services);

/// The same for other roles of sender and receivers (throughput): starts the role `sender` and
/// `plan.receivers` times the role `receiver`, each with the lane's descriptor as its first and,
/// for receivers, its index as its second argument, and returns when all have ended with status
/// 0.
void conduct_roles(const System& system, Lane& lane, Services& services, std::string_view sender,
                   std::string_view receiver);

}  // namespace agnocast::bench
