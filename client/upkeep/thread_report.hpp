// SPDX-License-Identifier: Apache-2.0
//
// ThreadReport: tells the daemon of the callback groups and threads of this process, as statements
// that outlive no connection: on each new one everything is reported again. Only the control thread
// uses it.
#pragma once

#include <client/connection/connection.hpp>
#include <client/process/thread_register.hpp>

#include <cstdint>
#include <set>
#include <utility>

namespace agnocast {

class ThreadReport {
 public:
  /// Tells what has changed since the last call. Throws std::bad_alloc; a later call goes on.
  void tell(Connection& connection);
  /// The connection has ended.
  void forget() noexcept;

 private:
  using GroupKey = std::pair<std::uint64_t, std::uint64_t>;  // executor, group

  std::uint64_t reported_version_ = 0;
  std::set<GroupKey> groups_;
  std::set<ThreadRegister::Thread> threads_;
};

}  // namespace agnocast
