// SPDX-License-Identifier: Apache-2.0
//
// Broker, what it notes about readers that get less than others: those that a publisher serves no more, which the
// publisher's process says, and those that nobody can ring, which the daemon finds. Each change is a record of the
// redo log, for people who ask later; nothing follows from it.

#include <base/clock.hpp>
#include <daemon/requests/broker.hpp>
#include <journal/withdrawal.hpp>

namespace agnocast::daemon {

// What a client says of its own publisher. The reader is looked up here: nothing of it is the client's word.
void Broker::note_withdrawn(Peer& peer, const wire::Withdrawn& said) {
  const ReaderPair pair{{Kind::publisher, static_cast<TopicIndex>(said.topic),
                         static_cast<std::uint32_t>(said.publisher)},
                        {Kind::subscription, static_cast<TopicIndex>(said.topic),
                         static_cast<std::uint32_t>(said.subscription)}};
  if (!registry_.is_used(pair.publisher) || !registry_.is_used(pair.reader) ||
      registry_.generation_of(pair.publisher) != said.publisher_generation ||
      registry_.generation_of(pair.reader) != said.subscription_generation ||
      registry_.owner_of(pair.publisher) != *peer.session.client() ||
      !registry_.told_of(pair.reader).contains(number(*peer.session.client())))
    return;
  const auto why = static_cast<abi::Withdrawal>(said.why);
  const bool is_served = why == abi::Withdrawal::none;
  const PeerIdentity& who = peer.session.identity();
  const ClientRecord& reader = registry_.client(registry_.owner_of(pair.reader));
  if (reader_notes_.take(who.uid, reader.uid, monotonic_ms())) {
    is_served ? registry_.note_served_again(pair) : registry_.note_withdrawn(pair, why);
  } else {
    auto& counters = registry_.counters();
    ++(is_served ? counters.readers_served_again : counters.readers_withdrawn);
  }
  const auto& topic = registry_.topic(pair.publisher.topic).name;
  if (is_served) {
    note(LogLevel::info, who.uid, "reader served again",
         {{"topic", topic},
          {"publisher_pid", who.pid},
          {"publisher_uid", who.uid},
          {"pid", reader.pid},
          {"uid", reader.uid}});
  } else {
    note(LogLevel::warning, who.uid, "reader withdrawn",
         {{"topic", topic},
          {"publisher_pid", who.pid},
          {"publisher_uid", who.uid},
          {"pid", reader.pid},
          {"uid", reader.uid},
          {"bytes", said.bytes},
          {"why", journal::sentence_of(why)}});
  }
}

void Broker::note_mute(const EndpointRef& subscription) {
  const ClientRecord& owner = registry_.client(registry_.owner_of(subscription));
  if (reader_notes_.take(owner.uid, owner.uid, monotonic_ms())) {
    registry_.note_mute(subscription);
  } else {
    ++registry_.counters().readers_mute;
  }
}

void Broker::note_new_reader(ClientIndex client, const CreateRequest& request) {
  if (!doorbells_.is_known_silent(client, request.executor)) return;
  const auto made = registry_.find_creation(client, Kind::subscription, request.request);
  if (made) note_mute(*made);
}

void Broker::look_for_silent_bells() {
  for (const Doorbells::Executor& silent : doorbells_.look()) {
    if (!registry_.is_alive(silent.client)) continue;
    for (const EndpointRef& ref : registry_.endpoints_of(silent.client)) {
      if (ref.kind != Kind::subscription) continue;
      const SubscriptionRecord& record = registry_.subscription(ref.topic, ref.index);
      if (record.state == EndpointState::active && record.executor == silent.executor)
        note_mute(ref);
    }
  }
}

}  // namespace agnocast::daemon
