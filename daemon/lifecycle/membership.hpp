// SPDX-License-Identifier: Apache-2.0
//
// Membership: who joins and leaves which topic, and who has to hear of it. docs/control-plane.md.
//
// Every operation has the same shape: check what the sender may say, let the registry decide and
// journal, then answer, then announce. An announcement is journaled before it is sent (rule RU, a).
// Who has no connection at the time is journaled all the same: it is to get the first and the last
// message of whoever comes and goes meanwhile. welcome_back() sends a process that has come back
// all that its announce sets say; so nothing that was sent on an earlier connection needs to be
// known to have arrived.
//
// What the end of something means is decided without I/O (endings.hpp, leaving.hpp) and carried out by
// EffectRunner.
#pragma once

#include <daemon/lifecycle/effect_runner.hpp>
#include <daemon/lifecycle/endings.hpp>
#include <daemon/lifecycle/leaving.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/doorbells.hpp>
#include <daemon/transport/post.hpp>
#include <daemon/transport/requests.hpp>
#include <daemon/transport/session.hpp>

#include <bitset>
#include <cstdint>
#include <functional>
#include <map>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::daemon {

class Membership {
 public:
  Membership(Registry& registry, Regions& regions, Doorbells& doorbells, Post& post);
  Membership(const Membership&) = delete;
  Membership& operator=(const Membership&) = delete;

  /// Called with a process that is over: everything of it may be used again.
  std::function<void(ClientIndex)> on_ended;
  /// Called with a publisher and the subscription it was just announced for.
  std::function<void(const EndpointRef&, const EndpointRef&)> on_matched;

  /// Creates an endpoint, answers and announces. Rights and quotas were checked. A failure is
  /// answered by the caller: type_mismatch, limit_reached, invalid_argument, os_failure.
  [[nodiscard]] Result<void> create(ClientIndex client, const CreateRequest& request);
  /// A creation that is asked for again: answers and announces as before, if it was carried out.
  bool answer_again(ClientIndex client, const CreateRequest& request);
  /// Errors: protocol_violation.
  [[nodiscard]] Result<void> leave(ClientIndex client, const LeaveRequest& request);
  [[nodiscard]] Result<void> drained(ClientIndex client, const DrainedRequest& request);
  [[nodiscard]] Result<void> unlinked(ClientIndex client, const wire::Unlinked& statement);
  /// Tells every process that has the region of `owner` about its newest window.
  void announce_window(ClientIndex owner);
  /// Announcements that went without doorbells because no descriptor was left: they are made again, by
  /// announce_renewed().
  bool has_waiting() const noexcept { return !waiting_.empty(); }
  void announce_waiting() { renewed_.merge(waiting_); }
  /// The bells of an executor are others now: publishers are told of its subscriptions once more, a part of
  /// them with each announce_renewed().
  void renewed(ClientIndex client, std::uint64_t executor);
  bool has_renewed() const noexcept { return !renewed_.empty(); }
  void announce_renewed();
  /// Tells a process on a new connection what it has and whom it knows. A part of it at first when
  /// that is much: go_on_telling() says more as the process reads.
  void welcome_back(ClientIndex client);
  void go_on_telling();
  /// Whether somebody is still being told, and whether this one is.
  bool tells() const noexcept { return !to_tell_.empty(); }
  bool tells(ClientIndex client) const { return to_tell_.contains(client); }

  /// Tells the owner of an endpoint what is the matter with it.
  void notice(const EndpointRef& ref, Errc code, const std::string& text,
              abi::QosPolicy policy = abi::QosPolicy::none);

  // --- the end of a process (death/client_death.hpp has the states)
  /// Decides; run() carries out what it says.
  Endings& endings() noexcept { return endings_; }
  const Endings& endings() const noexcept { return endings_; }
  void run(const Effects& effects) { runner_.run(effects); }
  /// The process has left the announce sets of all topics, and now leaves those of regions.
  void forget_client(ClientIndex client);

  // --- for a daemon that goes on
  /// Carries out what follows from the records of the former life and has no record yet: who has
  /// drained has let go as well, and what nobody has any more is free.
  void carry_out_what_is_owed();

 private:
  [[nodiscard]] Result<void> run(const Result<Effects>& decision);
  [[nodiscard]] Result<void> create_publisher(ClientIndex client, TopicIndex topic,
                                              const CreateRequest& request);
  [[nodiscard]] Result<void> create_subscription(ClientIndex client, TopicIndex topic,
                                                 const CreateRequest& request);
  [[nodiscard]] Result<void> make_ready(TopicIndex topic, const SubscriptionPlan& plan,
                                        ClientIndex client, std::uint64_t extent);
  void announce_publisher(TopicIndex topic, std::uint32_t index, std::uint32_t subscription);
  void announce_subscription(TopicIndex topic, std::uint32_t index, std::uint32_t publisher);
  bool are_of_one_user(ClientIndex one, ClientIndex other) const;
  void tell_members(const EndpointRef& ref);
  void answer_creation(const EndpointRef& ref, std::uint64_t request);
  Session* tell(const EndpointRef& ref, ClientIndex to);
  void announce(const EndpointRef& ref, ClientIndex to, Outgoing packet);
  /// What a process does not know yet on its connection, in this order.
  struct ToTell {
    std::map<std::uint64_t, EndpointRef> own;        // endpoints, by generation
    std::map<std::uint64_t, EndpointRef> endpoints;  // whose peers
    std::set<TopicIndex> topics;                     // what is over there
    std::uint32_t next_region = 0;                   // what it has of others
  };
  void add_doorbells(Outgoing& packet, const EndpointRef& ref, std::uint64_t generation,
                     bool same_user);
  bool is_to_know(const PublisherRecord& own, const SubscriptionRecord& other) const;
  void announce_to_owner(const EndpointRef& ref);
  /// Has a process a publisher that still looks at this subscription?
  bool is_looked_at(TopicIndex topic, const SubscriptionRecord& subscription, ClientIndex by) const;
  void say_own(const EndpointRef& ref);
  void tell_more(ClientIndex client, ToTell rest);
  void tell_next(ClientIndex client, ToTell& rest);
  void tell_what_is_over(ClientIndex client, TopicIndex topic);
  void tell_region(ClientIndex client, std::uint32_t owner);
  void notice_mismatches(const EndpointRef& ref, bool to_all = true);
  std::string type_mismatch_text(ClientIndex client, TopicIndex topic,
                                 const CreateRequest& request) const;
  void notice_types(ClientIndex client, TopicIndex topic, const std::string& text);

  Registry& registry_;
  Regions& regions_;
  Doorbells& doorbells_;
  Post& post_;
  Endings endings_;
  Leaving leaving_;
  EffectRunner runner_;
  // By client: the topics whose members have been told of its wrong types; once is enough. 512 bytes of each
  // process, 1 MiB of all.
  std::map<std::uint32_t, std::bitset<abi::topic_count_max>> type_notices_;
  // By client: what it could not be told because it had no connection. The first ones are enough.
  static constexpr std::size_t missed_notices_max = 64;
  std::map<std::uint32_t, std::vector<wire::Notice>> missed_notices_;
  // Subscriptions by generation: whose publishers are to be told of them once more, as soon as there is a
  // descriptor, and now. Not a pair each: most of a topic's publishers lack the same bells.
  std::map<std::uint64_t, EndpointRef> waiting_, renewed_;
  std::map<ClientIndex, ToTell> to_tell_;
};

}  // namespace agnocast::daemon
