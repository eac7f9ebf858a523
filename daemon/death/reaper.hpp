// SPDX-License-Identifier: Apache-2.0
//
// Reaping: the work after the end of a process.
//
// A dead process leaves holds on other processes' messages, at most one open intent per publisher,
// a region and windows that others still map. client_death.hpp has the steps and their order. A
// window may be used again only when every process that was notified of it has unmapped it (rule
// RU).
//
// Every step may be repeated. The reaper never trusts a value that the dead process wrote, and
// never takes the end of a connection for a death: only the pidfd proves it, or a process that has
// no trace of its region any more (after exec).
//
// Revoking is the same work on a process that lives and may go on storing: the reaper copies its
// heads once and repairs nothing in its region, because an interrupted publish may yet be
// completed. No process that was notified of the end reads beyond the copied head.
#pragma once

#include <daemon/death/client_death.hpp>
#include <daemon/lifecycle/endpoint_manager.hpp>

#include <sys/types.h>

#include <cstdint>
#include <optional>

namespace agnocast::daemon {

/// The repairs after a death, for the log.
struct Reaped {
  std::uint64_t subscriptions = 0;
  std::uint64_t publishers = 0;
  std::uint64_t rolled_back = 0;
  std::uint64_t rolled_forward = 0;
  std::uint64_t corrupt = 0;
};

/// The end of one process, endpoint by endpoint, and topic by topic of what it knew. `client` is
/// alive in the tables, or was being reaped when the daemon died; its process stores no more,
/// unless the reason is `revoked`. A process whose region was lost has no queues to repair: its
/// publishers end as they are. Between two calls the daemon serves others, to whom the rest of the
/// process looks as if it lived.
class Reaping {
 public:
  /// Records the death.
  Reaping(ClientIndex client, journal::DeathReason reason, Registry& registry, Regions& regions,
          Doorbells& doorbells, EndpointManager& endpoint_manager);

  /// Continues until that time (CLOCK_MONOTONIC), for at least one step. Returns true when done.
  bool go_on(std::uint64_t until_ns);
  ClientIndex client() const noexcept { return death_.client(); }
  const Reaped& reaped() const noexcept { return reaped_; }

 private:
  static ClientIndex die(ClientIndex client, journal::DeathReason reason, Registry& registry);
  // Each returns whether others may be served before the next step.
  bool carry_out(const death::Close& step);
  bool carry_out(const death::Orphan& step);
  bool carry_out(const death::Unmap& step);
  bool carry_out(const death::Acknowledge& step);
  bool carry_out(const death::FreeUnused& step);
  bool carry_out(const death::Forget& step);

  journal::DeathReason reason_;
  Registry& registry_;
  Regions& regions_;
  Doorbells& doorbells_;
  EndpointManager& endpoint_manager_;
  ClientDeath death_;
  Reaped reaped_;
};

/// Returns whether the process maps this file; also true when that cannot be known, and nothing
/// when there is no descriptor or no memory to look now.
std::optional<bool> maps_file(pid_t pid, const Regions::FileId& file) noexcept;

}  // namespace agnocast::daemon
