// SPDX-License-Identifier: Apache-2.0
//
// The facts that decide whether a process gets its place back. Pure.
#pragma once

#include <daemon/state/registry.hpp>
#include <daemon/transport/request_reading.hpp>
#include <journal/cases.hpp>

namespace agnocast::daemon {

/// Facts from the connections of the requester and of the place's owner.
struct Rejoiner {
  bool confirmed = false;     // the process that connected is the requester
  bool has_owner = false;     // a process has the place
  bool same_process = false;  // that process is the requester
};

/// Returns the facts for journal::decide_rejoin(). Reads nothing outside the tables.
journal::RejoinFacts rejoin_facts(const wire::Rejoin& request, const Registry& registry,
                                  const Rejoiner& who);

/// Returns whether the request names a place of the tables, taken or not.
bool names_place(const wire::Rejoin& request, const Registry& registry) noexcept;

}  // namespace agnocast::daemon
