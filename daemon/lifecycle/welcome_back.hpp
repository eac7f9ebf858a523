// SPDX-License-Identifier: Apache-2.0
//
// WelcomeBack: sends a process on a new connection its endpoints and their peers. If that is much,
// it sends a part first and the rest as the process reads.
#pragma once

#include <daemon/lifecycle/announcer.hpp>
#include <daemon/lifecycle/announcing.hpp>
#include <daemon/lifecycle/effect_runner.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/client_channel.hpp>

#include <cstdint>
#include <map>
#include <set>

namespace agnocast::daemon {

class WelcomeBack {
 public:
  WelcomeBack(const Registry& registry, const Announcing& announcing, Announcer& announcer,
              EffectRunner& runner, ClientChannel& channel) noexcept
      : registry_(registry),
        announcing_(announcing),
        announcer_(announcer),
        runner_(runner),
        channel_(channel) {}

  void begin(ClientIndex client);
  void go_on();
  /// Return whether any process, or this one, has not been sent everything yet.
  bool is_announcing() const noexcept { return !unannounced_.empty(); }
  bool is_announcing(ClientIndex client) const { return unannounced_.contains(client); }
  void forget_client(ClientIndex client) { unannounced_.erase(client); }

 private:
  /// What a process has not been sent yet on its connection, in this order.
  struct Unannounced {
    std::map<std::uint64_t, EndpointRef> own;        // endpoints, by generation
    std::map<std::uint64_t, EndpointRef> endpoints;  // endpoints whose peers are next
    std::set<TopicIndex> topics;                     // topics whose ended endpoints are next
    std::uint32_t next_region = 0;                   // regions of others that it has
  };
  void announce_more(ClientIndex client, Unannounced rest);
  void announce_next(ClientIndex client, Unannounced& rest);

  const Registry& registry_;
  const Announcing& announcing_;
  Announcer& announcer_;
  EffectRunner& runner_;
  ClientChannel& channel_;
  std::map<ClientIndex, Unannounced> unannounced_;
};

}  // namespace agnocast::daemon
