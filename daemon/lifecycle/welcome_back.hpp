// SPDX-License-Identifier: Apache-2.0
//
// WelcomeBack: a process on a new connection is told what it has and whom it knows. A part of it at
// first when that is much; the rest as the process reads.
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
  /// Whether somebody is still being told, and whether this one is.
  bool tells() const noexcept { return !to_tell_.empty(); }
  bool tells(ClientIndex client) const { return to_tell_.contains(client); }
  void forget_client(ClientIndex client) { to_tell_.erase(client); }

 private:
  /// What a process does not know yet on its connection, in this order.
  struct ToTell {
    std::map<std::uint64_t, EndpointRef> own;        // endpoints, by generation
    std::map<std::uint64_t, EndpointRef> endpoints;  // whose peers
    std::set<TopicIndex> topics;                     // what is over there
    std::uint32_t next_region = 0;                   // what it has of others
  };
  void tell_more(ClientIndex client, ToTell rest);
  void tell_next(ClientIndex client, ToTell& rest);

  const Registry& registry_;
  const Announcing& announcing_;
  Announcer& announcer_;
  EffectRunner& runner_;
  ClientChannel& channel_;
  std::map<ClientIndex, ToTell> to_tell_;
};

}  // namespace agnocast::daemon
