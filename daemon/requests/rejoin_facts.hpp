// SPDX-License-Identifier: Apache-2.0
//
// What decides whether a process gets its place back. Pure.
#pragma once

#include <daemon/state/registry.hpp>
#include <daemon/transport/requests.hpp>
#include <journal/cases.hpp>

namespace agnocast::daemon {

/// What the connections say of the one that asks, and of the one that has the place.
struct Rejoiner {
  bool confirmed = false;     // the process that connected is the one that asks
  bool has_owner = false;     // a process has the place
  bool same_process = false;  // and it is this one
};

/// Returns the facts for journal::decide_rejoin(). Looks at nothing that the request names outside
/// the tables.
journal::RejoinFacts rejoin_facts(const wire::Rejoin& request, const Registry& registry,
                                  const Rejoiner& who);

/// Whether the request names a place of the tables, taken or not.
bool names_place(const wire::Rejoin& request, const Registry& registry) noexcept;

}  // namespace agnocast::daemon
