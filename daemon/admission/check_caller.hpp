// SPDX-License-Identifier: Apache-2.0
//
// Checks that a process which sends hello, rejoin or observe speaks for itself and has the
// daemon's layout.
#pragma once

#include <agnocast/result.hpp>
#include <base/sockets/peer_identity.hpp>

#include <cstdint>

namespace agnocast::daemon {

/// Checks the caller. Errors: layout_mismatch, permission_denied.
[[nodiscard]] Result<void> check_caller(const PeerIdentity& who, std::uint64_t fingerprint);

}  // namespace agnocast::daemon
