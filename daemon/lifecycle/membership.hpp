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
// settle() is the other half of rule RU: called for whatever somebody has let go of, it frees what
// nobody has any more, and then what that made free: endpoint, topic, process.
#pragma once

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
  Membership(Registry& registry, Regions& regions, Doorbells& doorbells, Post& post) noexcept
      : registry_(registry), regions_(regions), doorbells_(doorbells), post_(post) {}

  /// Called with a process that is over: everything of it may be used again.
  std::function<void(ClientIndex)> on_ended;
  /// Called with a publisher and the subscription it was just announced for.
  std::function<void(const EndpointRef&, const EndpointRef&)> on_matched;

  /// Creates an endpoint, answers and announces. Rights and quotas were checked. A failure is
  /// answered by the caller: type_mismatch, limit_reached, invalid_argument, os_failure.
  [[nodiscard]] Result<void> create(ClientIndex client, const CreateRequest& request);
  /// A creation that is asked for again: answers and announces as before, if it was carried out.
  bool answer_again(ClientIndex client, const CreateRequest& request);
  /// A refusal for lack of places, and who keeps publishers there that are gone (of that user).
  [[nodiscard]] tl::unexpected<Failure> explain_full(TopicIndex topic, const Failure& why,
                                                     std::optional<std::uint32_t> uid = {}) const;
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

  // --- for the reaper
  /// A subscription whose process is no member any more.
  void bury_subscription(const EndpointRef& ref);
  /// Nobody publishes there any more: board, then everybody is rung and told.
  void orphan(const EndpointRef& ref, std::uint64_t final_head, journal::LeaveCause cause);
  /// Frees the endpoint if it is over and nobody has it any more, and with it its topic and its process.
  void settle(const EndpointRef& ref);
  void settle_topic(TopicIndex topic);
  /// When it has left the announce sets of all topics.
  void forget_client(ClientIndex client);
  /// Frees the place of a process if nobody has anything of it any more.
  void settle_client(ClientIndex client);
  void settle_clients();
  /// Of the processes that are gone and of which others have something, gives up the oldest of the user
  /// who has most, when they are too many.
  void limit_gone();
  /// What is over, by the user whose it was and generation: whoever was told of it and holds nothing of it
  /// is to let go now.
  using GivenUp = std::map<std::uint32_t, std::map<std::uint64_t, EndpointRef>>;
  const GivenUp& given_up() const noexcept { return given_up_; }

  // --- for a daemon that goes on
  /// Carries out what follows from the records of the former life and has no record yet: who has
  /// drained has let go as well, and what nobody has any more is free.
  void finish();

 private:
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
  void say_orphaned(const EndpointRef& ref, ClientIndex to);
  void notice_mismatches(const EndpointRef& ref, bool to_all = true);
  std::string type_mismatch_text(ClientIndex client, TopicIndex topic,
                                 const CreateRequest& request) const;
  [[nodiscard]] bool may_judge(ClientIndex client, const Announced& subject, std::uint64_t seen);
  void notice_types(ClientIndex client, TopicIndex topic, const std::string& text);
  void kick(TopicIndex topic, std::uint32_t publisher);
  void kick_publishers_of(const EndpointRef& subscription);
  void forget_subscription(const EndpointRef& ref);
  void limit_orphans(TopicIndex topic);
  void limit_dead_subscriptions(TopicIndex topic);
  void give_up_oldest(std::vector<std::pair<std::uint64_t, EndpointRef>>& over, std::size_t kept);
  void give_up(const EndpointRef& ref);
  std::uint32_t user_of(const EndpointRef& ref) const;
  bool is_given_up(const EndpointRef& ref) const;
  void forget_given_up(const EndpointRef& ref);
  void give_up_all_of(ClientIndex client);
  void let_go(const EndpointRef& ref, ClientIndex by);
  /// Frees what nobody has any more, everywhere.
  void settle_all();
  void say_done(ClientIndex client, const wire::Reference& reference);
  bool is_own(ClientIndex client, const wire::Reference& reference) const;
  bool is_active(ClientIndex client, const wire::Reference& reference) const;
  /// Nothing is left to be drained.
  bool is_drained(ClientIndex client, const wire::Reference& reference) const;
  template <class Function>
  void for_each_told(const AnnounceSet& set, Function function) const;

  Registry& registry_;
  Regions& regions_;
  Doorbells& doorbells_;
  Post& post_;
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
  GivenUp given_up_;
};

}  // namespace agnocast::daemon
