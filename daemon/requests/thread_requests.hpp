// SPDX-License-Identifier: Apache-2.0
//
// ThreadRequests: what a process says of its callback groups and threads, and the rules of
// [[thread]] that are applied to these threads.
//
// The statements change tables only; go_on() gives threads whose rule is due to errands, one errand
// of a few threads for each user at a time.
#pragma once

#include <base/text/log.hpp>
#include <daemon/config/config.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/errands.hpp>
#include <daemon/transport/request_reading.hpp>

#include <cstdint>
#include <set>
#include <vector>

namespace agnocast::daemon {

class ThreadRequests {
 public:
  ThreadRequests(const Config& config, const Registry& registry, ConnectionTable& connections,
                 Errands& errands, Log& log) noexcept
      : config_(config),
        registry_(registry),
        connections_(connections),
        errands_(errands),
        log_(log) {}

  [[nodiscard]] Result<void> callback_group(Peer& peer, const wire::CallbackGroup& statement);
  [[nodiscard]] Result<void> callback_thread(Peer& peer, const wire::CallbackThread& statement);

  /// Returns whether go_on() has work.
  bool has_due() const noexcept;
  /// Begins to apply rules to threads that are due.
  void go_on();

 private:
  struct Batch;
  struct DuePeer {
    PeerId id;
    std::uint32_t uid;
  };

  bool is_known_enough(const Peer& peer, std::uint32_t thread) const;
  CallbackThreads& threads_of(Peer& peer);
  void end_change(Peer& peer);
  void apply_some(Peer& peer);
  void end_batch(const Batch& batch);
  void report(const Batch& batch, const CallbackThreads::Due& due,
              const CallbackThreads::Outcome& outcome);

  const Config& config_;
  const Registry& registry_;
  ConnectionTable& connections_;
  Errands& errands_;
  Log& log_;
  std::vector<DuePeer> due_;
  std::set<std::uint32_t> busy_;  // users with an errand
};

}  // namespace agnocast::daemon
