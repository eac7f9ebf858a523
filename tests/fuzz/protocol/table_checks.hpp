// SPDX-License-Identifier: Apache-2.0
//
// Table checks: what the daemon has written in one place agrees with what it has written elsewhere.
// They abort where it does not. What it should have written is for the oracle to know.
#pragma once

#include <daemon/state/address_plan.hpp>
#include <daemon/state/registry.hpp>

namespace agnocast::daemon::fuzz {

/// The board says of every endpoint what the tables say.
void check_board(const Registry& registry, const Registry::Memory& memory);
/// A registry that is opened on the memory finds the same as the one that wrote it.
void check_restart(const Registry& registry, const Registry::Memory& memory);
/// All processes are dead, so no place is taken and no window used.
void check_nothing_left(const Registry& registry, const AddressPlan& plan);

}  // namespace agnocast::daemon::fuzz
