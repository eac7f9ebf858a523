// SPDX-License-Identifier: Apache-2.0
//
// LifecycleTest: the daemon's core with processes whose connections keep each packet that they were
// sent, with its descriptors, in the order of all.
#pragma once

#include <daemon/lifecycle/references.hpp>
#include <tests/support/processes/daemon_core.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

namespace agnocast::daemon {

class LifecycleTest : public testing::Test {
 protected:
  struct Sent {
    ClientIndex to{};
    Outgoing packet;

    template <class Body>
    Body body() const {
      Body read{};
      std::memcpy(&read, packet.bytes.data(), std::min(sizeof read, packet.bytes.size()));
      return read;
    }
    wire::Opcode opcode() const { return body<wire::Header>().opcode; }
  };
  using Line = std::pair<ClientIndex, wire::Opcode>;

  explicit LifecycleTest(const Capacity& capacity = {}) : core(capacity) {
    core.channel.on_send = [this](ClientIndex to, const Outgoing& packet) {
      sent.push_back({to, packet});
    };
  }

  Session& connect(ClientIndex client) { return core.channel.connect(client); }
  /// Connects a process of a user whose other connections are full: it gets a part at a time.
  Session& connect_slowly(ClientIndex client) {
    const auto user = std::make_shared<KeptForUser>();
    user->bytes_max = 1;
    return core.channel.connect(client, user);
  }
  ClientIndex connected_process(std::uint32_t uid = 1000) {
    const ClientIndex client = core.process(uid);
    connect(client);
    return client;
  }
  EndpointRef add(ClientIndex owner, Kind kind, const std::string& topic = "/topic") {
    return core.create(owner, kind, topic);
  }

  /// Returns the packets of one kind, as their bodies.
  template <class Body>
  std::vector<Body> all(wire::Opcode opcode) const {
    std::vector<Body> found;
    for (const Sent& one : sent) {
      if (one.opcode() == opcode) found.push_back(one.template body<Body>());
    }
    return found;
  }
  /// Returns which process was sent what.
  std::vector<Line> lines() const {
    std::vector<Line> found;
    for (const Sent& one : sent) found.emplace_back(one.to, one.opcode());
    return found;
  }
  std::size_t count_to(ClientIndex client) const {
    return static_cast<std::size_t>(
        std::count_if(sent.begin(), sent.end(), [&](const Sent& one) { return one.to == client; }));
  }
  /// Returns the place that a packet names.
  template <class Body>
  static EndpointRef place_in(const Body& packet) {
    return {packet.kind, TopicIndex{packet.topic}, static_cast<std::uint32_t>(packet.index)};
  }
  wire::Reference reference(const EndpointRef& ref) const {
    return reference_to(ref, registry.generation_of(ref), wire::Opcode::leave);
  }
  wire::Unlinked unlinked(const EndpointRef& ref, std::uint64_t seen) const {
    wire::Unlinked statement{};
    statement.kind = ref.kind;
    statement.topic = number(ref.topic);
    statement.index = ref.index;
    statement.generation = registry.generation_of(ref);
    statement.seen = seen;
    return statement;
  }
  wire::Unlinked region_unlinked(ClientIndex owner, std::uint64_t seen) const {
    wire::Unlinked statement{};
    statement.kind = Kind::region;
    statement.index = number(owner);
    statement.generation = registry.client(owner).generation;
    statement.seen = seen;
    return statement;
  }
  /// Returns how many packets the process was sent on this connection.
  std::uint64_t packets_to(ClientIndex client) {
    return core.channel.session_of(client)->packet_count();
  }
  bool is_notified(const EndpointRef& ref, ClientIndex client) const {
    return registry.notified_of(ref).contains(number(client));
  }

  std::vector<Sent> sent;
  test::DaemonCore core;
  Registry& registry = core.registry;
  EndpointManager& manager = core.endpoint_manager;
};

}  // namespace agnocast::daemon
