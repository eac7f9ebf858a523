// SPDX-License-Identifier: Apache-2.0
//
// EndpointManager: who joins and leaves which topic, and who has to hear of it.
// docs/control-plane.md.
//
// Every operation has the same shape: check what the sender may say, let the registry decide and
// journal, then answer, then announce. An announcement is journaled before it is sent (rule RU, a).
// Who has no connection at the time is journaled all the same: it is to get the first and the last
// message of whoever comes and goes meanwhile. welcome_back() sends a process that has come back
// all that its announce sets say; so nothing that was sent on an earlier connection needs to be
// known to have arrived.
//
// What the end of something means is decided without I/O (endings.hpp, leaving.hpp), and so is who
// is told (announcing.hpp). EffectRunner carries it out.
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
#include <daemon/transport/requests.hpp>
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

  /// Called with a process that is over: everything of it may be used again.
  std::function<void(ClientIndex)> on_client_freed;
  /// Called with a publisher and the subscription it was just announced for.
  void set_on_matched(std::function<void(const EndpointRef&, const EndpointRef&)> then) {
    announcer_.on_matched = std::move(then);
  }

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
  void announce_window(ClientIndex owner) { announcer_.announce_window(owner); }
  /// Announcements that went without doorbells because no descriptor was left: they are made again,
  /// by announce_renewed().
  bool has_waiting() const noexcept { return announcer_.has_waiting(); }
  void announce_waiting() { announcer_.move_waiting_to(renewed_); }
  /// The doorbells of an executor are others now: publishers are told of its subscriptions once
  /// more, a part of them with each announce_renewed().
  void renewed(ClientIndex client, std::uint64_t executor);
  bool has_renewed() const noexcept { return !renewed_.empty(); }
  void announce_renewed();
  /// Tells a process on a new connection what it has and whom it knows. A part of it at first when
  /// that is much: go_on_telling() says more as the process reads.
  void welcome_back(ClientIndex client) { welcome_back_.begin(client); }
  void go_on_telling() { welcome_back_.go_on(); }
  /// Whether somebody is still being told.
  bool tells() const noexcept { return welcome_back_.tells(); }

  /// Tells the owner of an endpoint what is the matter with it.
  void notice(const EndpointRef& ref, Errc code, const std::string& text) {
    announcer_.notice(ref, code, text);
  }

  // --- the end of a process (death/client_death.hpp has the states)
  /// Decides; run() carries out what it says.
  Endings& endings() noexcept { return endings_; }
  const Endings& endings() const noexcept { return endings_; }
  void run(const Effects& effects) { runner_.run(effects); }
  /// The process has left the announce sets of all topics, and now leaves those of regions.
  void forget_client(ClientIndex client);

  // --- for a daemon that goes on
  /// Carries out what follows from the records of the previous run and has no record yet: who has
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
  // By client: the topics whose endpoints have been told of its wrong types; once is enough. 512
  // bytes of each process, 1 MiB of all.
  std::map<std::uint32_t, std::bitset<abi::topic_count_max>> type_notices_;
  // Subscriptions by generation: whose publishers are to be told of them once more.
  Announcer::ByGeneration renewed_;
};

}  // namespace agnocast::daemon
