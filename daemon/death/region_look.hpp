// SPDX-License-Identifier: Apache-2.0
//
// RegionLook: whether a process still has its region mapped.
//
// A process may have tens of thousands of mappings, and reading them takes a tenth of a second; one
// that holds the lock of its memory keeps whoever reads waiting. That is its user's time, and what
// it took is not to be most of what a processor does: for a while none of its processes is looked
// at, and the next tick asks again.
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
  /// How many processes of one user wait for a look at their files in /proc.
  static constexpr std::size_t waiting_max = 256;

  RegionLook(ConnectionTable& connections, Errands& errands, const Regions& regions) noexcept
      : connections_(connections), errands_(errands), regions_(regions) {}

  /// Has a thread look at the maps of the process; `then` is called later, in the loop. False: not
  /// now, and `then` is never called.
  bool begin(const Peer& peer, std::function<void(RegionTrace)> then);

 private:
  ConnectionTable& connections_;
  Errands& errands_;
  const Regions& regions_;
  std::shared_ptr<char> here_ = std::make_shared<char>();  // for errands that end later
};

}  // namespace agnocast::daemon
