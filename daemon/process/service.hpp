// SPDX-License-Identifier: Apache-2.0
//
// Service: one life of the daemon, from what it finds to its end.
//
//   nothing is kept                a new life: a fresh board, a new incarnation
//   a previous run is kept          it goes on (requests/recovery.hpp)
//   that life is of another        nothing of it is touched, everybody is refused (refuser.hpp)
//   build, or damaged
//
// At the end socket and doorbells are removed; not when a manager keeps descriptors, because then
// the next run goes on with them. SIGINT is the exception: our supervisor says with it that no life
// follows.
#pragma once

#include <base/text/log.hpp>
#include <daemon/config/config.hpp>
#include <daemon/transport/descriptor_store.hpp>

#include <optional>
#include <string>

namespace agnocast::daemon {

/// Why it cannot run here, and what can be done.
struct Trouble {
  std::string what;
  std::string hint;
};

/// Runs until it is told to end.
std::optional<Trouble> serve(const Config& config, const std::string& socket, DescriptorStore store,
                             Log& log);

}  // namespace agnocast::daemon
