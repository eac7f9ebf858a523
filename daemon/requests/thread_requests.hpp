// SPDX-License-Identifier: Apache-2.0
//
// ThreadRequests: what a process says of its callback groups and threads, and the rules of
// [[thread]] that are applied to these threads.
//
// The statements change tables only; go_on() applies the rules, a few threads a turn of the loop,
// however many threads a process has made due.
#pragma once

#include <base/text/log.hpp>
#include <daemon/config/config.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/requests.hpp>

#include <vector>

namespace agnocast::daemon {

class ThreadRequests {
 public:
  ThreadRequests(const Config& config, const Registry& registry, ConnectionTable& connections,
                 Log& log) noexcept
      : config_(config), registry_(registry), connections_(connections), log_(log) {}

  [[nodiscard]] Result<void> callback_group(Peer& peer, const wire::CallbackGroup& statement);
  [[nodiscard]] Result<void> callback_thread(Peer& peer, const wire::CallbackThread& statement);

  /// Returns whether go_on() has work.
  bool has_due() const noexcept { return !due_.empty(); }
  /// Applies rules to some of the threads that are due.
  void go_on();

 private:
  CallbackThreads& threads_of(Peer& peer);
  void end_change(Peer& peer);
  void apply(Peer& peer, std::uint32_t number, const CallbackThreads::Thread& thread);

  const Config& config_;
  const Registry& registry_;
  ConnectionTable& connections_;
  Log& log_;
  std::vector<PeerId> due_;  // with due threads
};

}  // namespace agnocast::daemon
