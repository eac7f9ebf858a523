// SPDX-License-Identifier: Apache-2.0
//
// Flight recorder: the records that the redo log still has, as packets for an observer, with names
// beside the numbers. Pure; made in one iteration of the loop, at most as many as the log holds.
//
// A record names places (topic 3, process 7), and places are used again. One counter gives out all
// generations: a place still has the same owner as at the time of the record exactly if its
// present owner is not younger than the generation in the record. A record's own pid is always
// sent.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/session.hpp>

#include <cstdint>
#include <vector>

namespace agnocast::daemon {

/// Returns the answer to the request, oldest record first; it ends with journal_end. Never fails:
/// an unreadable record is sent as damaged.
std::vector<Outgoing> make_journal(const Registry& registry, const abi::wire::ReadJournal& request,
                                   std::uint64_t now_ns);

}  // namespace agnocast::daemon
