// SPDX-License-Identifier: Apache-2.0
//
// Service: one run of the daemon, from what it finds in the store to its end.
//
//   the store is empty             begin: a fresh board, a new incarnation
//   it has a previous run          continue that (requests/recovery.hpp)
//   that run is damaged, or of     touch nothing of it, refuse all clients (refuser.hpp)
//   another build
//
// At the end the daemon removes socket and doorbells, unless a manager keeps descriptors: then the
// next run continues with them. SIGINT is the exception: with it the daemon's own supervisor
// announces that no run follows.
#pragma once

#include <base/text/log.hpp>
#include <daemon/config/config.hpp>
#include <daemon/transport/descriptor_store.hpp>

#include <optional>
#include <string>

namespace agnocast::daemon {

/// Why the daemon cannot run here, and a remedy.
struct Trouble {
  std::string what;
  std::string hint;
};

/// Runs until a signal ends it. Returns what prevented it from running, if anything did.
std::optional<Trouble> serve(const Config& config, const std::string& socket, DescriptorStore store,
                             Log& log);

}  // namespace agnocast::daemon
