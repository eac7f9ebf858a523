// SPDX-License-Identifier: Apache-2.0

#include <client/process/steps.hpp>
#include <client/upkeep/collector.hpp>

#include <cstdint>

namespace agnocast {

namespace wire = abi::wire;
using wire::Kind;
using wire::Opcode;

void Collector::collect(Connection& connection) {
  collect_publishers(connection);
  collect_subscriptions(connection);
  collect_peers(connection);
}

void Collector::scan() {
  for (const auto& publisher : endpoints_.publishers()) publisher->run_upkeep();
}

void Collector::collect_publishers(Connection& connection) {
  for (const auto& publisher : endpoints_.publishers()) {
    publisher->run_upkeep();
    if (!publisher->is_over()) continue;
    AGNOCAST_CRASH_POINT(C_publisher_over);
    const auto endpoints = publisher->detach_all();
    const auto& identity = publisher->identity();
    const std::uint32_t topic = publisher->topic_index();
    endpoints_.erase(*publisher);
    AGNOCAST_CRASH_POINT(C_erased);
    // Another publisher of this process on this topic may still be attached to some of them.
    for (const auto& [index, generation] : endpoints) {
      if (!endpoints_.is_attached(topic, index, generation))
        say_unlinked(connection, Kind::subscription, topic, index, generation);
    }
    connection.post(Opcode::drained,
                    reference(Kind::publisher, topic, identity.index, identity.generation));
  }
}

void Collector::collect_subscriptions(Connection& connection) {
  endpoints_.collect_subscriptions(
      [&](std::uint32_t topic, const Link& link) {
        say_unlinked(connection, Kind::publisher, topic, link.publisher(), link.generation());
      },
      [&](const EndpointTable::Key& key, std::uint64_t generation) {
        connection.post(Opcode::drained,
                        reference(Kind::subscription, key.first, key.second, generation));
      });
}

void Collector::collect_peers(Connection& connection) {
  peers_.collect([&](const PeerTable::Key& process) {
    say_unlinked(connection, Kind::region, 0, process.first, process.second);
  });
}

void Collector::collect_alone() {
  for (const auto& publisher : endpoints_.publishers()) {
    publisher->remove_dead_subscriptions();
    if (!publisher->is_finished()) continue;
    AGNOCAST_CRASH_POINT(C_finish);
    publisher->finish();
    AGNOCAST_CRASH_POINT(C_finish);
    endpoints_.erase(*publisher);
  }
  for (const auto& subscription : endpoints_.subscriptions()) {
    subscription->collect_alone();
    if (!subscription->is_finished()) continue;
    AGNOCAST_CRASH_POINT(C_finish);
    subscription->finish();
    AGNOCAST_CRASH_POINT(C_finish);
    endpoints_.erase(*subscription);
  }
  peers_.collect_alone();
}

}  // namespace agnocast
