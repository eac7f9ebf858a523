// SPDX-License-Identifier: Apache-2.0
//
// Flight recorder: the records of the redo log that are still there, as packets for an observer,
// with names beside the numbers. Pure; made in one iteration of the loop, at most as many as the
// log holds.
//
// A record names places (topic 3, process 7), and places are used again. One counter gives out all
// generations, so what is at a place now is what was there when the record was made exactly when it
// is not younger than the generation that the record speaks of. A record that has a pid itself is
// sent with it afterwards as well.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/session.hpp>

#include <cstdint>
#include <vector>

namespace agnocast::daemon {

/// The answer to the request, oldest record first; it ends with journal_end. Never fails: a record
/// that cannot be read is sent as damaged.
std::vector<Outgoing> make_journal(const Registry& registry, const abi::wire::ReadJournal& request,
                                   std::uint64_t now_ns);

}  // namespace agnocast::daemon
