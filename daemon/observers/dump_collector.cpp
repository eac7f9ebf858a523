// SPDX-License-Identifier: Apache-2.0
//
// DumpCollector: see the header.

#include <daemon/observers/dump_collector.hpp>

#include <agnocast/version.hpp>
#include <base/clock.hpp>

#include <unistd.h>

#include <algorithm>

namespace agnocast::daemon {

void DumpCollector::collect_daemon(wire::DumpDaemon& daemon, std::uint64_t now_ns) const {
  daemon.version_major = AGNOCAST_VERSION_MAJOR;
  daemon.version_minor = AGNOCAST_VERSION_MINOR;
  daemon.version_patch = AGNOCAST_VERSION_PATCH;
  daemon.pid = static_cast<std::uint32_t>(::getpid());
  daemon.uid = ::geteuid();
  daemon.incarnation = from_.registry.incarnation();
  daemon.uptime_ns = now_ns - from_.registry.header().began_ns;
  daemon.arena_base = from_.arena.base;
  daemon.arena_bytes = from_.arena.bytes;
  daemon.window_bytes = from_.arena.window_bytes;
  daemon.windows_used = from_.plan.used_count();
  daemon.log_level = static_cast<std::uint32_t>(from_.log.level());
  daemon.kept_descriptors = from_.store.kept_count();
  daemon.kept_descriptors_max = from_.store.keeps() ? from_.store.capacity() : 0;
  daemon.counters = from_.registry.counters();
  const Config::Limits& limits = from_.config.limits;
  daemon.limits = {limits.clients,
                   limits.topics,
                   limits.publishers_per_topic,
                   limits.subscriptions_per_topic,
                   limits.slots_per_publisher,
                   limits.depth_max,
                   from_.config.heap.windows_per_process};
  const Config::Quota& quota = from_.config.quota;
  daemon.quota = {quota.clients,
                  quota.publishers,
                  quota.subscriptions,
                  quota.wait_sets,
                  from_.admission.heap_quota(),
                  quota.held_messages,
                  quota.topics,
                  quota.queued_bytes,
                  quota.queued_seconds,
                  quota.dumps_per_second,
                  from_.admission.places_quota(Kind::publisher),
                  from_.admission.places_quota(Kind::subscription),
                  quota.callback_groups,
                  quota.callback_threads};
}

DumpFacts::Process DumpCollector::process_of(ClientIndex client, std::uint64_t now_ns) const {
  DumpFacts::Process process;
  const Peer* const peer = from_.connections.of_client(client);
  if (peer != nullptr && peer->threads != nullptr) process.threads = &peer->threads->table;
  if (peer != nullptr)
    process.state = peer->detached ? wire::ProcessState::orphaned : wire::ProcessState::connected;
  if (from_.registry.is_revoked(client)) process.state = wire::ProcessState::revoked;
  process.age_ns = now_ns - from_.registry.client(client).since_ns;
  process.region = from_.regions.region_reader(client);
  const std::uint64_t wait_sets = from_.registry.client(client).wait_sets;
  for (std::uint64_t wait_set = 0; wait_set < abi::wait_set_count_max; ++wait_set) {
    if ((wait_sets >> wait_set & 1) != 0 && from_.doorbells.is_silent(client, wait_set))
      process.silent_wait_sets |= std::uint64_t{1} << wait_set;
  }
  for (const Obstacles::Claim& claim : from_.obstacles.of(client)) {
    process.blocked_bytes += claim.bytes;
    if (process.blocked_by.empty()) process.blocked_by = claim.what;
  }
  return process;
}

DumpFacts DumpCollector::collect() const {
  const std::uint64_t now = monotonic_ns();
  DumpFacts facts;
  wire::DumpDaemon& daemon = facts.daemon;
  collect_daemon(daemon, now);
  const std::uint64_t now_ms = monotonic_ms();
  for (const auto& [id, peer] : from_.connections.all()) {
    std::uint64_t& waits_ms = facts.users[peer->session.identity().uid].waits_ms;
    waits_ms = std::max(waits_ms, peer->session.waits_ms(now_ms));
  }
  for (const auto& [uid, used] : from_.connections.users()) {
    DumpFacts::User& user = facts.users[uid];
    user.connections = used.clients;
    user.observers = used.observers;
    user.queued_bytes = used.kept->bytes;
    user.callback_groups = used.kept->callback_groups;
    user.callback_threads = used.kept->callback_threads;
    daemon.connections += used.clients;
    daemon.observers += used.observers;
  }
  facts.refusals = from_.refusals.all();
  facts.thread_rules = from_.config.threads;
  facts.now_ns = now;
  facts.process_of = [this, now](ClientIndex client) { return process_of(client, now); };
  return facts;
}

}  // namespace agnocast::daemon
