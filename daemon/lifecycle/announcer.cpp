// SPDX-License-Identifier: Apache-2.0
//
// Announcer: see the header.

#include <daemon/lifecycle/announcer.hpp>

#include <base/check.hpp>
#include <daemon/lifecycle/references.hpp>

#include <algorithm>
#include <cstddef>
#include <cstring>

namespace agnocast::daemon {
namespace {

/// Returns the fields that both kinds of endpoint have; the caller adds the receiver's.
template <class Record>
wire::Announcement announcement_of(const EndpointRef& ref, const Record& record,
                                   const Registry& registry) {
  auto packet = make_body<wire::Announcement>(wire::Opcode::announce);
  packet.kind = ref.kind;
  packet.topic = number(ref.topic);
  packet.index = ref.index;
  packet.generation = record.generation;
  packet.client = number(record.client);
  packet.client_generation = registry.client(record.client).generation;
  packet.extent = record.extent;
  packet.qos = record.qos;
  packet.uid = registry.client(record.client).uid;
  return packet;
}

}  // namespace

Session* Announcer::record_notified(const EndpointRef& ref, ClientIndex to) {
  if (!registry_.is_alive(to) || regions_.region_reader(registry_.owner_of(ref)) == nullptr)
    return nullptr;
  registry_.notify(ref, to);
  return channel_.session_of(to);
}

void Announcer::announce(const EndpointRef& subject, const EndpointRef& receiver) {
  if (subject.kind == Kind::publisher) {
    announce_publisher(subject.topic, subject.index, receiver.index);
  } else {
    announce_subscription(subject.topic, subject.index, receiver.index);
  }
}

void Announcer::announce_publisher(TopicIndex topic, std::uint32_t index,
                                   std::uint32_t subscription) {
  const PublisherRecord& publisher = registry_.publisher(topic, index);
  const SubscriptionRecord& receiver = registry_.subscription(topic, subscription);
  if (record_notified({Kind::publisher, topic, index}, receiver.client) == nullptr) return;
  auto packet = announcement_of({Kind::publisher, topic, index}, publisher, registry_);
  packet.own_index = subscription;
  packet.own_generation = receiver.generation;
  packet.first_sequence = abi::first_sequence_of(publisher.generation);
  packet.quota = registry_.hold_quota(receiver, publisher);
  // One counter serves all generations: the publisher joined later.
  packet.from_start = publisher.generation > receiver.generation ? 1 : 0;
  packet.same_user = are_of_one_user(publisher.client, receiver.client) ? 1 : 0;
  std::vector<SharedFd> fds{regions_.region_reader(publisher.client)};
  const ClientRecord& owner = registry_.client(publisher.client);
  for (const SharedFd& reader : regions_.window_readers(publisher.client)) {
    const WindowRecord& window = owner.window[packet.window_count];
    packet.window[packet.window_count++] = {window.base, window.bytes, window.first};
    fds.push_back(reader);
  }
  const auto bytes = packet_of(packet);
  send({Kind::publisher, topic, index}, receiver.client,
       {{bytes.begin(), bytes.end()}, std::move(fds), {}});
  if (on_matched)
    on_matched({Kind::publisher, topic, index}, {Kind::subscription, topic, subscription});
}

// The same uid in two user namespaces means two users.
bool Announcer::are_of_one_user(ClientIndex one, ClientIndex other) const {
  const std::uint64_t user_namespace = channel_.user_namespace_of(one);
  return registry_.client(one).uid == registry_.client(other).uid && user_namespace != 0 &&
         user_namespace == channel_.user_namespace_of(other);
}

void Announcer::announce_subscription(TopicIndex topic, std::uint32_t index,
                                      std::uint32_t publisher) {
  const SubscriptionRecord& subscription = registry_.subscription(topic, index);
  const PublisherRecord& receiver = registry_.publisher(topic, publisher);
  if (record_notified({Kind::subscription, topic, index}, receiver.client) == nullptr) return;
  auto packet = announcement_of({Kind::subscription, topic, index}, subscription, registry_);
  packet.own_index = publisher;
  packet.own_generation = receiver.generation;
  packet.wait_set = subscription.wait_set;
  packet.quota = registry_.hold_quota(subscription, receiver);
  const bool same_user = are_of_one_user(subscription.client, receiver.client);
  packet.same_user = same_user ? 1 : 0;
  const auto bytes = packet_of(packet);
  send({Kind::subscription, topic, index}, receiver.client,
       {{bytes.begin(), bytes.end()},
        {regions_.region_reader(subscription.client)},
        [=, this, generation = subscription.generation](Outgoing& out) {
          add_doorbells(out, {Kind::subscription, topic, index}, generation, same_user);
        }});
}

// The subscription may be over by now: a process that drained its last publisher there has
// acknowledged it without reading the announcement. Another subscription, perhaps of another user,
// may then have its place, and the receiver must not get that one's doorbells.
void Announcer::add_doorbells(Outgoing& packet, const EndpointRef& ref, std::uint64_t generation,
                              bool same_user) {
  if (!registry_.is_used(ref)) return;
  const SubscriptionRecord& subscription = registry_.subscription(ref.topic, ref.index);
  if (subscription.generation != generation ||
      (subscription.state != EndpointState::active && subscription.state != EndpointState::leaving))
    return;
  const auto doorbells =
      doorbells_.for_publisher(subscription.client, subscription.wait_set, same_user);
  if (!doorbells) {
    waiting_.emplace(generation, ref);
    return;
  }
  packet.fds.insert(packet.fds.end(), doorbells->begin(), doorbells->end());
  const auto count = static_cast<std::uint32_t>(doorbells->size());
  std::memcpy(packet.bytes.data() + offsetof(wire::Announcement, doorbell_count), &count,
              sizeof count);
}

void Announcer::send(const EndpointRef& ref, ClientIndex to, Outgoing packet) {
  Session* const session = channel_.session_of(to);
  AGNOCAST_CHECK(session != nullptr);
  // The number of the packet that is about to be sent.
  session->announcements().announced(subject_of(ref), session->packet_count() + 1);
  session->announcements().announced(region_of(registry_.owner_of(ref)),
                                     session->packet_count() + 1);
  channel_.send(to, std::move(packet));
}

void Announcer::announce_window(ClientIndex owner) {
  const ClientRecord& record = registry_.client(owner);
  auto packet = make_body<wire::WindowAnnounced>(wire::Opcode::window_announced);
  packet.client = number(owner);
  packet.client_generation = record.generation;
  packet.window = record.window_count - 1;
  packet.base = record.window[packet.window].base;
  packet.bytes = record.window[packet.window].bytes;
  packet.first = record.window[packet.window].first;
  const SharedFd reader = regions_.window_readers(owner).back();
  // A process that has the region because it publishes to `owner` reads nothing in its heap.
  const auto reads = [&](ClientIndex to) {
    const auto& endpoints = registry_.endpoints_of(owner);
    return std::any_of(endpoints.begin(), endpoints.end(), [&](const EndpointRef& ref) {
      return ref.kind == Kind::publisher && registry_.notified_of(ref).contains(number(to));
    });
  };
  for_each_notified(registry_, record.notified, [&](ClientIndex to) {
    Session* const session = channel_.session_of(to);
    if (session == nullptr || !reads(to)) return;
    session->announcements().announced(region_of(owner), session->packet_count() + 1);
    channel_.send(to, packet_of(packet), {reader});
  });
}

void Announcer::announce_region(ClientIndex client, ClientIndex owner) {
  const ClientRecord& record = registry_.client(owner);
  if (record.state == ClientState::free || !record.notified.contains(number(client))) return;
  auto packet = make_body<wire::Reference>(wire::Opcode::region);
  packet.kind = Kind::region;
  packet.index = number(owner);
  packet.generation = record.generation;
  // A statement of the client about the region counts only if it has read this packet.
  Session* const session = channel_.session_of(client);
  AGNOCAST_CHECK(session != nullptr);
  session->announcements().announced(region_of(owner), session->packet_count() + 1);
  channel_.send(client, packet_of(packet), {});
}

// --- notices

void Announcer::notice(const EndpointRef& ref, Errc code, const std::string& text,
                       abi::QosPolicy policy) {
  auto packet = make_body<wire::Notice>(wire::Opcode::notice);
  packet.code = static_cast<std::uint32_t>(code);
  packet.policy = policy;
  packet.kind = ref.kind;
  packet.topic = number(ref.topic);
  packet.index = ref.index;
  packet.generation = registry_.generation_of(ref);
  packet.text = name_of(text);
  const ClientIndex owner = registry_.owner_of(ref);
  // A collision is found again when the process is back; other notices would be lost.
  if (code != Errc::arena_occupied && channel_.session_of(owner) == nullptr) {
    auto& missed = missed_notices_[number(owner)];
    if (missed.size() < missed_notices_max) missed.push_back(packet);
    return;
  }
  channel_.send(owner, packet_of(packet), {});
}

void Announcer::send_missed_notices(ClientIndex client) {
  const auto missed = missed_notices_.extract(number(client));
  if (missed.empty()) return;
  for (const wire::Notice& packet : missed.mapped()) channel_.send(client, packet_of(packet), {});
}

}  // namespace agnocast::daemon
