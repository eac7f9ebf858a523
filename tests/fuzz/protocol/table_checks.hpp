// SPDX-License-Identifier: Apache-2.0
//
// Table checks: the daemon's records in different places agree with each other. They abort
// otherwise. The oracle judges what the records should be.
#pragma once

#include <daemon/state/address_plan.hpp>
#include <daemon/state/registry.hpp>

namespace agnocast::daemon::fuzz {

/// The board agrees with the tables about every endpoint.
void check_board(const Registry& registry, const Registry::Memory& memory);
/// A registry opened on the memory finds the same state as the one that wrote it.
void check_restart(const Registry& registry, const Registry::Memory& memory);
/// All processes are dead, so no place is taken and no window used.
void check_nothing_left(const Registry& registry, const AddressPlan& plan);

}  // namespace agnocast::daemon::fuzz
