// SPDX-License-Identifier: Apache-2.0
//
// UserNamespaces: finds the user namespace of a process that connects.
//
// Before Linux 6.11 only /proc shows it, and reading that may block: until then nothing is read
// from the process.
#pragma once

#include <daemon/serving/request_scheduler.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/errands.hpp>

#include <memory>

namespace agnocast::daemon {

class UserNamespaces {
 public:
  UserNamespaces(ConnectionTable& connections, Errands& errands,
                 RequestScheduler& scheduler) noexcept
      : connections_(connections), errands_(errands), scheduler_(scheduler) {}

  /// Fills in Session::user_namespace, now or later; 0 when it cannot be found.
  void find(Peer& peer);

 private:
  ConnectionTable& connections_;
  Errands& errands_;
  RequestScheduler& scheduler_;
  std::shared_ptr<char> here_ = std::make_shared<char>();  // expires before errands that end later
};

}  // namespace agnocast::daemon
