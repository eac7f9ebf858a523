// SPDX-License-Identifier: Apache-2.0
//
// The daemon's core without its sockets: registry, endpoint manager and reaper on memory as the
// daemon has it, and processes without connections.
#pragma once

#include <daemon/death/reaper.hpp>
#include <tests/support/machine/temporary_directory.hpp>

#include <gtest/gtest.h>

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

namespace agnocast::test {

struct DaemonCore {
  /// Only clients for which a test makes a session are connected; the session counts their
  /// packets.
  class Connections final : public daemon::ClientChannel {
   public:
    using daemon::ClientChannel::send;
    daemon::Session* session_of(daemon::ClientIndex client) override {
      const auto found = sessions.find(client);
      return found == sessions.end() ? nullptr : &found->second;
    }
    std::uint64_t user_namespace_of(daemon::ClientIndex client) override {
      const auto found = user_namespaces.find(client);
      return found == user_namespaces.end() ? 0 : found->second;
    }
    void send(daemon::ClientIndex client, daemon::Outgoing packet) override {
      daemon::Session* const session = session_of(client);
      if (session == nullptr) return;
      if (on_send) on_send(client, packet);
      session->push(std::move(packet));
      if (!keeps_output) session->drop_output();
    }
    void begin_anew(daemon::ClientIndex client, std::string_view) override {
      sessions.erase(client);
    }

    /// Connects a process, once more if it is connected.
    daemon::Session& connect(
        daemon::ClientIndex client,
        std::shared_ptr<daemon::KeptForUser> user = std::make_shared<daemon::KeptForUser>()) {
      sessions.erase(client);
      return sessions.try_emplace(client, PacketSocket(), PeerIdentity(), std::move(user))
          .first->second;
    }

    std::map<daemon::ClientIndex, daemon::Session> sessions;
    std::map<daemon::ClientIndex, std::uint64_t> user_namespaces;  // 0 for others: unknown
    /// Called before each packet to a connected process.
    std::function<void(daemon::ClientIndex, const daemon::Outgoing&)> on_send;
    bool keeps_output = false;  // no process reads
  };

  explicit DaemonCore(const daemon::Capacity& capacity = {})
      : regions(daemon::Regions::create(store).value()),
        registry(regions.memory(), capacity),
        doorbells(directory.path(), store),
        endpoint_manager(registry, regions, doorbells, channel) {
    registry.create(1);
  }

  daemon::ClientIndex process(std::uint32_t uid) {
    const daemon::ClientPlan plan = registry.plan_client().value();
    EXPECT_TRUE(regions.open_client(plan.index, plan.generation));
    registry.add_client({uid, uid, 1, 0, "a process"}, plan);
    EXPECT_TRUE(doorbells.open(plan.index, 0, 0));
    registry.open_wait_set(plan.index, 0);
    return plan.index;
  }
  /// Returns a request for an endpoint, with an id of its own.
  daemon::CreateRequest request(daemon::Kind kind, const std::string& topic) {
    daemon::CreateRequest asked;
    asked.kind = kind;
    asked.request = ++last_request;
    asked.topic = topic;
    asked.type = "T";
    asked.node = "node";
    asked.qos = {1, false, true, false, false};
    asked.quota = 1;
    return asked;
  }
  daemon::EndpointRef create(daemon::ClientIndex client, daemon::Kind kind,
                             const std::string& topic) {
    return create(client, request(kind, topic));
  }
  daemon::EndpointRef create(daemon::ClientIndex client, const daemon::CreateRequest& asked) {
    const auto created = endpoint_manager.create(client, asked);
    EXPECT_TRUE(created) << (created ? "" : detail_of(created.error()));
    return registry.find_creation(client, asked.kind, asked.request)
        .value_or(daemon::EndpointRef());
  }
  void end(daemon::ClientIndex client) {
    daemon::Reaping reaping(client, journal::DeathReason::died, registry, regions, doorbells,
                            endpoint_manager);
    EXPECT_TRUE(reaping.go_on(UINT64_MAX));
  }

  TemporaryDirectory directory;
  daemon::DescriptorStore store;
  daemon::Regions regions;
  daemon::Registry registry;
  Connections channel;
  daemon::Doorbells doorbells;
  daemon::EndpointManager endpoint_manager;
  std::uint64_t last_request = 0;
};

}  // namespace agnocast::test
