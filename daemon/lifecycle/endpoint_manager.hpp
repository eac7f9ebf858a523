// SPDX-License-Identifier: Apache-2.0
//
// EndpointManager: lets endpoints join and leave topics, and notifies the processes concerned.
// docs/control-plane.md.
//
// Every operation has the same shape: check what the sender may ask for, let the registry decide
// and commit, then answer, then announce. An announcement is recorded before it is sent (rule RU,
// a), also for a process without a connection: it is to get the first and the last message of
// publishers that come and go meanwhile. welcome_back() sends a process that has come back all
// that its announce sets say, so the daemon need not know which packets of an earlier connection
// arrived.
//
// endings.hpp and leaving.hpp decide without I/O what an end means, announcing.hpp which processes
// are notified; EffectRunner carries it out.
#pragma once

#include <daemon/lifecycle/announcer.hpp>
#include <daemon/lifecycle/announcing.hpp>
#include <daemon/lifecycle/effect_runner.hpp>
#include <daemon/lifecycle/endings.hpp>
#include <daemon/lifecycle/leaving.hpp>
#include <daemon/lifecycle/regions.hpp>
#include <daemon/lifecycle/welcome_back.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/client_channel.hpp>
#include <daemon/transport/doorbells.hpp>
#include <daemon/transport/request_reading.hpp>
#include <daemon/transport/session.hpp>

#include <bitset>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <utility>

namespace agnocast::daemon {

class EndpointManager {
 public:
  EndpointManager(Registry& registry, Regions& regions, Doorbells& doorbells,
                  ClientChannel& channel);
  EndpointManager(const EndpointManager&) = delete;
  EndpointManager& operator=(const EndpointManager&) = delete;

  /// Called with a process that is over: its memory and addresses may be used again.
  std::function<void(ClientIndex)> on_client_freed;
  /// Called with a publisher and the subscription it was just announced for.
  void set_on_matched(std::function<void(const EndpointRef&, const EndpointRef&)> then) {
    announcer_.on_matched = std::move(then);
  }

  /// Creates an endpoint, answers and announces. The caller has checked rights and quotas, and
  /// answers a failure: type_mismatch, limit_reached, invalid_argument, os_failure.
  [[nodiscard]] Result<void> create(ClientIndex client, const CreateRequest& request);
  /// Handles a repeated creation: answers and announces as before. Returns false if there was
  /// none.
  bool answer_again(ClientIndex client, const CreateRequest& request);
  /// Returns the length of the extent that the endpoint gets if it is created now.
  std::uint64_t extent_bytes(ClientIndex client, const CreateRequest& request) const;
  /// Names the topics that are wide when they begin.
  void use_wide_topics(std::vector<std::string> names) { wide_topics_ = std::move(names); }
  /// Carry out requests about ends of endpoints. Errors: protocol_violation.
  [[nodiscard]] Result<void> leave(ClientIndex client, const LeaveRequest& request);
  [[nodiscard]] Result<void> drained(ClientIndex client, const DrainedRequest& request);
  [[nodiscard]] Result<void> unlinked(ClientIndex client, const wire::Unlinked& statement);
  /// Announces the newest window of `owner` to every process that has its region.
  void announce_window(ClientIndex owner) { announcer_.announce_window(owner); }
  /// Announcements without doorbells, for lack of descriptors; announce_renewed() repeats them.
  bool has_waiting() const noexcept { return announcer_.has_waiting(); }
  void announce_waiting() { announcer_.move_waiting_to(renewed_); }
  /// The doorbells of a wait set have changed: its subscriptions are announced to publishers once
  /// more, some of them with each announce_renewed().
  void renewed(ClientIndex client, std::uint64_t wait_set);
  bool has_renewed() const noexcept { return !renewed_.empty(); }
  void announce_renewed();
  /// Sends a process on a new connection its endpoints and their peers. If that is much, sends a
  /// part; go_on_announcing() sends more as the process reads.
  void welcome_back(ClientIndex client) { welcome_back_.begin(client); }
  void go_on_announcing() { welcome_back_.go_on(); }
  /// Returns whether a process has not been sent everything yet.
  bool is_announcing() const noexcept { return welcome_back_.is_announcing(); }

  /// Sends the owner of an endpoint a notice about it.
  void notice(const EndpointRef& ref, Errc code, const std::string& text) {
    announcer_.notice(ref, code, text);
  }

  // --- the end of a process (death/client_death.hpp has the states)
  /// Returns the decisions about ends; run() carries out their effects.
  Endings& endings() noexcept { return endings_; }
  const Endings& endings() const noexcept { return endings_; }
  void run(const Effects& effects) { runner_.run(effects); }
  /// Removes the process from the announce sets of regions. It has left those of all topics.
  void forget_client(ClientIndex client);

  // --- for a daemon that continues
  /// Carries out what follows from the records of the previous run and has no record yet:
  /// acknowledgements of processes that have drained, and the release of unused places.
  void carry_out_what_is_owed();

 private:
  std::uint32_t link_blocks_of_new(std::string_view topic) const;
  [[nodiscard]] Result<void> run(const Result<Effects>& decision);
  [[nodiscard]] Result<void> create_publisher(ClientIndex client, TopicIndex topic,
                                              const CreateRequest& request);
  [[nodiscard]] Result<void> create_subscription(ClientIndex client, TopicIndex topic,
                                                 const CreateRequest& request);
  [[nodiscard]] Result<void> make_ready(TopicIndex topic, const SubscriptionPlan& plan,
                                        ClientIndex client, std::uint64_t extent);
  /// Backs what all subscriptions of the topic have for its publishers.
  [[nodiscard]] Result<void> back_links_of_all(TopicIndex topic, const LinkBlocks& slots);
  /// Lets a subscription that has joined begin with what the publishers of its topic commit from
  /// now on. Leaves out those that it was linked to, or for which this was done, before.
  void set_starts(TopicIndex topic, std::uint32_t subscription);
  std::string type_mismatch_text(ClientIndex client, TopicIndex topic,
                                 const CreateRequest& request) const;
  void notice_types(ClientIndex client, TopicIndex topic, const std::string& text);

  Registry& registry_;
  Regions& regions_;
  Doorbells& doorbells_;
  ClientChannel& channel_;
  Endings endings_;
  Leaving leaving_;
  Announcing announcing_;
  Announcer announcer_;
  EffectRunner runner_;
  WelcomeBack welcome_back_;
  // By client: topics whose endpoints have been notified of its wrong types; once is enough. 512
  // bytes for each process, 1 MiB for all.
  std::map<std::uint32_t, std::bitset<abi::topic_count_max>> type_notices_;
  std::vector<std::string> wide_topics_;
  // Subscriptions, by generation, to be announced to their publishers once more.
  Announcer::ByGeneration renewed_;
};

}  // namespace agnocast::daemon
