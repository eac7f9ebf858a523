// SPDX-License-Identifier: Apache-2.0
//
// Leaving: see the header.

#include <daemon/lifecycle/leaving.hpp>

#include <daemon/lifecycle/references.hpp>
#include <journal/cases.hpp>

#include <optional>

namespace agnocast::daemon {
namespace {

/// Returns whether the request was carried out and only its answer was lost. The checks that
/// follow refuse invalid requests.
bool is_done_before(std::uint8_t what, bool again, bool is_so) noexcept {
  return journal::decide_request(what, again,
                                 is_so ? journal::request::done : journal::request::not_done) ==
         journal::RequestDecision::say_done;
}

/// Validity of a statement that a process made after so many packets.
enum class Worth : std::uint8_t { counts, is_void, unknown };

Worth worth_of(const Reader& reader, const Announced& subject, std::uint64_t seen) {
  if (reader.announcements.is_void(subject, seen)) return Worth::is_void;
  if (reader.announcements.may_be_void(subject, seen)) return Worth::unknown;
  return Worth::counts;
}

}  // namespace

bool Leaving::is_own(ClientIndex client, const wire::Reference& reference) const {
  const EndpointRef ref = ref_of(reference);
  if (!registry_.is_used(ref)) return false;
  return state_of(registry_, ref) != EndpointState::free && registry_.owner_of(ref) == client &&
         registry_.generation_of(ref) == reference.generation;
}

bool Leaving::is_active(ClientIndex client, const wire::Reference& reference) const {
  return is_own(client, reference) &&
         state_of(registry_, ref_of(reference)) == EndpointState::active;
}

bool Leaving::is_drained(ClientIndex client, const wire::Reference& reference) const {
  if (!is_own(client, reference)) return true;
  const EndpointRef ref = ref_of(reference);
  return ref.kind == Kind::subscription && state_of(registry_, ref) == EndpointState::over;
}

effect::Send Leaving::done(ClientIndex client, const wire::Reference& reference) const {
  return {client, make_body<wire::Done>(wire::Opcode::done, reference.header.request)};
}

Effects Leaving::answered_again(ClientIndex client, const wire::Reference& reference) const {
  return {effect::CountAnsweredAgain{}, done(client, reference)};
}

Result<Effects> Leaving::leave(ClientIndex client, const LeaveRequest& request,
                               std::uint64_t final_head) const {
  const wire::Reference& reference = request.reference;
  if (is_done_before(journal::request::leave, request.again, !is_active(client, reference)))
    return answered_again(client, reference);
  if (!is_own(client, reference))
    return fail(Errc::protocol_violation, "this is not an endpoint of the process");
  const EndpointRef ref = ref_of(reference);
  const bool is_publisher = ref.kind == Kind::publisher;
  if (state_of(registry_, ref) != EndpointState::active)
    return fail(Errc::protocol_violation, is_publisher ? "the publisher has left before"
                                                       : "the subscription has left before");
  Effects effects;
  if (is_publisher) {
    effects = endings_.orphan(ref, final_head, journal::LeaveCause::left);
  } else {
    effects.push_back(effect::ChangeSubscription{ref, EndpointState::leaving});
    append(effects, endings_.kick_publishers_of(ref));
  }
  effects.push_back(done(client, reference));
  effects.push_back(effect::FreeUnused{ref});
  return effects;
}

Result<Effects> Leaving::drained(ClientIndex client, const DrainedRequest& request) const {
  const wire::Reference& reference = request.reference;
  if (is_done_before(journal::request::drained, request.again, is_drained(client, reference)))
    return answered_again(client, reference);
  if (!is_own(client, reference))
    return fail(Errc::protocol_violation, "this is not an endpoint of the process");
  const EndpointRef ref = ref_of(reference);
  const bool is_publisher = ref.kind == Kind::publisher;
  const EndpointState expected = is_publisher ? EndpointState::over : EndpointState::leaving;
  if (state_of(registry_, ref) != expected)
    return fail(Errc::protocol_violation, is_publisher ? "the publisher's word is not free yet"
                                                       : "the subscription has not left");
  return is_publisher ? publisher_drained(client, reference)
                      : subscription_drained(client, reference);
}

// With the last publisher of a process in the topic, the process has unmapped everything there.
Effects Leaving::publisher_drained(ClientIndex client, const wire::Reference& reference) const {
  const EndpointRef ref = ref_of(reference);
  Effects effects{effect::EndPublisher{ref, EndpointState::free}, done(client, reference)};
  bool is_last = true;
  registry_.for_each_publisher(ref.topic, [&](std::uint32_t i, const PublisherRecord& record) {
    is_last = is_last && (i == ref.index || record.client != client);
  });
  if (is_last) {
    registry_.for_each_subscription(ref.topic, [&](std::uint32_t i, const SubscriptionRecord&) {
      append(effects, endings_.acknowledge({Kind::subscription, ref.topic, i}, client));
    });
  }
  effects.push_back(effect::FreeUnusedTopic{ref.topic});
  return effects;
}

bool Leaving::has_another_reader(ClientIndex client, const EndpointRef& subscription,
                                 const PublisherRecord& publisher) const {
  bool has = false;
  registry_.for_each_subscription(
      subscription.topic, [&](std::uint32_t i, const SubscriptionRecord& record) {
        has = has ||
              (i != subscription.index && record.client == client &&
               (record.state == EndpointState::active || record.state == EndpointState::leaving) &&
               matches(publisher, record));
      });
  return has;
}

Effects Leaving::subscription_drained(ClientIndex client, const wire::Reference& reference) const {
  const EndpointRef ref = ref_of(reference);
  Effects effects{effect::ChangeSubscription{ref, EndpointState::over}, done(client, reference)};
  registry_.for_each_publisher(ref.topic, [&](std::uint32_t p, const PublisherRecord& record) {
    if (!has_another_reader(client, ref, record))
      append(effects, endings_.acknowledge({Kind::publisher, ref.topic, p}, client));
  });
  append(effects, endings_.ask_to_unmap(ref));
  effects.push_back(effect::FreeUnused{ref});
  effects.push_back(effect::FreeUnusedTopic{ref.topic});
  return effects;
}

Result<Effects> Leaving::unlinked(ClientIndex client, const wire::Unlinked& statement,
                                  const Reader& reader) const {
  if (statement.seen > reader.packet_count)
    return fail(Errc::protocol_violation,
                "the process claims to have seen more packets than were sent");
  if (statement.kind == Kind::region) return region_unlinked(client, statement, reader);
  const EndpointRef ref{statement.kind, static_cast<TopicIndex>(statement.topic),
                        static_cast<std::uint32_t>(statement.index)};
  if (!registry_.is_used(ref) || registry_.generation_of(ref) != statement.generation)
    return Effects{};  // late: the endpoint is over
  const Worth worth = worth_of(reader, subject_of(ref), statement.seen);
  if (worth == Worth::unknown) return Effects{effect::BeginAnew{client}};
  if (worth == Worth::is_void) return Effects{};
  Effects effects{effect::ForgetAnnounced{client, subject_of(ref)}};
  append(effects, endings_.acknowledge(ref, client));
  return effects;
}

Result<Effects> Leaving::region_unlinked(ClientIndex client, const wire::Unlinked& statement,
                                         const Reader& reader) const {
  const ClientIndex owner{static_cast<std::uint32_t>(statement.index)};
  if (number(owner) >= registry_.client_high() ||
      registry_.client(owner).state == ClientState::free ||
      registry_.client(owner).generation != statement.generation)
    return Effects{};  // late: the process is over
  // A process that is still being notified will be asked again afterwards.
  if (reader.is_being_announced_to) return Effects{};
  const Worth worth = worth_of(reader, region_of(owner), statement.seen);
  if (worth == Worth::unknown) return Effects{effect::BeginAnew{client}};
  if (worth == Worth::is_void) return Effects{};
  for (const EndpointRef& ref : registry_.endpoints_of(owner)) {
    if (registry_.notified_of(ref).contains(number(client)))
      return fail(Errc::protocol_violation,
                  "the process still has an endpoint of this region linked");
  }
  return Effects{effect::ForgetAnnounced{client, region_of(owner)},
                 effect::AcknowledgeRegion{owner, client}, effect::FreeUnusedClient{owner}};
}

}  // namespace agnocast::daemon
