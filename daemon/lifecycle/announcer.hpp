// SPDX-License-Identifier: Apache-2.0
//
// Announcer: announces endpoints of one process to another: record, packet, descriptors and
// doorbells. It also sends owners notices about their endpoints. announcing.hpp decides which
// endpoint is announced to which process.
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

  /// Records that the process is about to be notified of the endpoint, and has to unmap it before
  /// the place is used again. Returns its connection; null: none, it is notified when it is back.
  Session* record_notified(const EndpointRef& ref, ClientIndex to);
  /// Announces the endpoint `subject` to the process of `receiver`, an endpoint of the other kind.
  void announce(const EndpointRef& subject, const EndpointRef& receiver);
  /// Announces the newest window of `owner` to every process that has its region.
  void announce_window(ClientIndex owner);
  /// Names to a process the region that it has of another one, if it has that.
  void announce_region(ClientIndex client, ClientIndex owner);
  /// Sends the owner of an endpoint a notice about it. Without a connection, keeps it for later.
  void notice(const EndpointRef& ref, Errc code, const std::string& text,
              abi::QosPolicy policy = abi::QosPolicy::none);
  /// Sends what notice() kept for a process without a connection.
  void send_missed_notices(ClientIndex client);
  void forget_client(ClientIndex client) { missed_notices_.erase(number(client)); }

  /// Subscriptions, by generation, announced without doorbells for lack of descriptors.
  using ByGeneration = std::map<std::uint64_t, EndpointRef>;
  bool has_waiting() const noexcept { return !waiting_.empty(); }
  void move_waiting_to(ByGeneration& others) {
    others.merge(waiting_);
    waiting_.clear();  // merge() leaves those that `others` has already
  }

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
  // By client: notices for a process without a connection. The first ones are enough.
  static constexpr std::size_t missed_notices_max = 64;
  std::map<std::uint32_t, std::vector<wire::Notice>> missed_notices_;
  // Not one entry a pair: most of a topic's publishers lack the same doorbells.
  ByGeneration waiting_;
};

}  // namespace agnocast::daemon
