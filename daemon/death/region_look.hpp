// SPDX-License-Identifier: Apache-2.0
//
// RegionLook: finds out whether a process still has its region mapped.
//
// A process may have tens of thousands of mappings, and reading them takes a tenth of a second; a
// process that holds the lock of its memory makes the reader wait. That time is charged to its
// user and must not be most of a processor's: for a while no process of the user is looked at, and
// the next tick asks again.
#pragma once

#include <daemon/lifecycle/regions.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/errands.hpp>

#include <cstddef>
#include <functional>
#include <memory>

namespace agnocast::daemon {

class RegionLook {
 public:
  /// Maximum number of processes of one user that wait for a look at their files in /proc.
  static constexpr std::size_t waiting_max = 256;

  RegionLook(ConnectionTable& connections, Errands& errands, const Regions& regions) noexcept
      : connections_(connections), errands_(errands), regions_(regions) {}

  /// Makes a thread look at the maps of the process; `then` is called later, in the loop. Returns
  /// false: not now, and `then` is never called.
  bool begin(const Peer& peer, std::function<void(RegionTrace)> then);

 private:
  ConnectionTable& connections_;
  Errands& errands_;
  const Regions& regions_;
  std::shared_ptr<char> here_ = std::make_shared<char>();  // expires before errands that end later
};

}  // namespace agnocast::daemon
