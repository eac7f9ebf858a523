// SPDX-License-Identifier: Apache-2.0
//
// Dump: everything the daemon knows, as packets for an observer. Pure; made in one iteration of
// the loop, so all packets together show one moment.
//
// The caller passes what the registry does not hold (connections, their ages, counters). A
// process's region goes along for reading: metadata, no message. Windows never do.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <daemon/config/thread_rules.hpp>
#include <daemon/state/callback_threads.hpp>
#include <daemon/state/refusals.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/session.hpp>
#include <daemon/transport/shared_fd.hpp>

#include <cstdint>
#include <functional>
#include <map>
#include <span>
#include <string>
#include <vector>

namespace agnocast::daemon {

struct DumpFacts {
  struct Process {
    abi::wire::ProcessState state = abi::wire::ProcessState::dead;
    std::uint64_t age_ns = 0;
    SharedFd region;  // empty when there is none
    std::uint64_t silent_wait_sets = 0;
    std::uint64_t blocked_bytes = 0;
    std::string blocked_by;
    const CallbackThreads* threads = nullptr;  // null: it has said nothing of them
  };
  struct User {
    std::uint64_t connections = 0;
    std::uint64_t observers = 0;
    std::uint64_t queued_bytes = 0;
    std::uint64_t waits_ms = 0;  // age of the oldest of them
    std::uint64_t answers_ahead = 0;
    std::uint64_t callback_groups = 0;
    std::uint64_t callback_threads = 0;
  };
  abi::wire::DumpDaemon daemon{};       // without its header
  std::map<std::uint32_t, User> users;  // with connections; make_dump() adds owners
  std::function<Process(ClientIndex)> process_of;
  std::span<const Refusals::Refusal> refusals;
  std::span<const ThreadRule> thread_rules;
  std::uint64_t now_ns = 0;  // CLOCK_MONOTONIC
};

/// Returns the answer to the request, in order; it ends with dump_end.
std::vector<Outgoing> make_dump(const Registry& registry, const DumpFacts& facts,
                                const abi::wire::Dump& request);

}  // namespace agnocast::daemon
