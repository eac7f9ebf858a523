// SPDX-License-Identifier: Apache-2.0
//
// The daemon's core without its sockets: registry, endpoint manager and reaper on memory as the
// daemon has it, and processes without connections.
#pragma once

#include <daemon/death/reaper.hpp>
#include <tests/support/machine/temporary_directory.hpp>

#include <gtest/gtest.h>

#include <cstdint>
#include <string>

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
    std::uint64_t user_namespace_of(daemon::ClientIndex) override { return 0; }
    void send(daemon::ClientIndex client, daemon::Outgoing packet) override {
      daemon::Session* const session = session_of(client);
      if (session == nullptr) return;
      session->push(std::move(packet));
      session->drop_output();
    }
    void begin_anew(daemon::ClientIndex client, std::string_view) override {
      sessions.erase(client);
    }

    std::map<daemon::ClientIndex, daemon::Session> sessions;
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
  daemon::EndpointRef create(daemon::ClientIndex client, daemon::Kind kind,
                             const std::string& topic) {
    daemon::CreateRequest request;
    request.kind = kind;
    request.request = ++last_request;
    request.topic = topic;
    request.type = "T";
    request.node = "node";
    request.qos = {1, false, true, false, false};
    request.quota = 1;
    const auto created = endpoint_manager.create(client, request);
    EXPECT_TRUE(created) << (created ? "" : detail_of(created.error()));
    return registry.find_creation(client, kind, request.request).value_or(daemon::EndpointRef());
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
