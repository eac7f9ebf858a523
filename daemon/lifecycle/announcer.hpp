// SPDX-License-Identifier: Apache-2.0
//
// Announcer: hands endpoints of one process out to another: record, packet, descriptors and
// doorbells; and tells owners what is the matter with their endpoints. What is announced to whom is
// decided in announcing.hpp.
#pragma once

#include <agnocast/abi/words.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/client_channel.hpp>
#include <daemon/transport/doorbells.hpp>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <vector>

namespace agnocast::daemon {

class Announcer {
 public:
  Announcer(Registry& registry, Regions& regions, Doorbells& doorbells,
            ClientChannel& channel) noexcept
      : registry_(registry), regions_(regions), doorbells_(doorbells), channel_(channel) {}
  Announcer(const Announcer&) = delete;
  Announcer& operator=(const Announcer&) = delete;

  /// Called with a publisher and the subscription it was just announced for.
  std::function<void(const EndpointRef&, const EndpointRef&)> on_matched;

  /// The process is about to be told of the endpoint, and has to unmap it before the place is used
  /// again. Returns its connection; null: it has none, and is announced this when it is back.
  Session* record_member(const EndpointRef& ref, ClientIndex to);
  /// Tells the process of `receiver` of the endpoint `subject`, which is of the other kind.
  void announce(const EndpointRef& subject, const EndpointRef& receiver);
  /// Tells every process that has the region of `owner` about its newest window.
  void announce_window(ClientIndex owner);
  /// Tells a process which region it has of another one, if it has that.
  void announce_region(ClientIndex client, ClientIndex owner);
  /// Tells the owner of an endpoint what is the matter with it, when it has a connection.
  void notice(const EndpointRef& ref, Errc code, const std::string& text,
              abi::QosPolicy policy = abi::QosPolicy::none);
  /// What notice() had to keep for a process that had no connection.
  void send_missed_notices(ClientIndex client);
  void forget_client(ClientIndex client) { missed_notices_.erase(number(client)); }

  /// Subscriptions, by generation, that were announced without doorbells because no descriptor was
  /// left.
  using ByGeneration = std::map<std::uint64_t, EndpointRef>;
  bool has_waiting() const noexcept { return !waiting_.empty(); }
  void move_waiting_to(ByGeneration& others) { others.merge(waiting_); }

 private:
  void announce_publisher(TopicIndex topic, std::uint32_t index, std::uint32_t subscription);
  void announce_subscription(TopicIndex topic, std::uint32_t index, std::uint32_t publisher);
  bool are_of_one_user(ClientIndex one, ClientIndex other) const;
  void add_doorbells(Outgoing& packet, const EndpointRef& ref, std::uint64_t generation,
                     bool same_user);
  void send(const EndpointRef& ref, ClientIndex to, Outgoing packet);

  Registry& registry_;
  Regions& regions_;
  Doorbells& doorbells_;
  ClientChannel& channel_;
  // By client: what it could not be told because it had no connection. The first ones are enough.
  static constexpr std::size_t missed_notices_max = 64;
  std::map<std::uint32_t, std::vector<wire::Notice>> missed_notices_;
  // Not a pair each: most of a topic's publishers lack the same doorbells.
  ByGeneration waiting_;
};

}  // namespace agnocast::daemon
