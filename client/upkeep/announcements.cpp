// SPDX-License-Identifier: Apache-2.0

#include <client/process/steps.hpp>
#include <client/upkeep/announcements.hpp>

#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>

namespace agnocast {

namespace wire = abi::wire;
using wire::Kind;
using wire::Opcode;

struct Announcements::Handler {
  Opcode opcode;
  void (Announcements::*handle)(Connection&, Incoming&);
};

bool Announcements::handle(Connection& connection, Incoming& packet) {
  static constexpr Handler handlers[] = {
      {Opcode::announce, &Announcements::on_announce},
      {Opcode::window_announced, &Announcements::on_window},
      {Opcode::forget, &Announcements::on_forget},
      {Opcode::orphaned, &Announcements::on_orphaned},
      {Opcode::kick, &Announcements::on_kick},
      {Opcode::notice, &Announcements::on_notice},
      {Opcode::move_heap, &Announcements::on_move_heap},
  };
  const Opcode opcode = packet.header().opcode;
  const auto* const found =
      std::find_if(std::begin(handlers), std::end(handlers),
                   [&](const Handler& handler) { return handler.opcode == opcode; });
  if (found == std::end(handlers)) return false;
  (this->*found->handle)(connection, packet);
  return true;
}

namespace {

/// Returns a mute doorbell if the daemon sent none, no descriptor was free for it, or the owner's
/// share is used up.
PublisherEndpoint::PeerDoorbell doorbell_among(std::span<UniqueFd> fds, std::size_t before,
                                               std::uint32_t count, DescriptorShare::Owner owner) {
  if (count == 0 || count > 2 || fds.size() < before + count) return {};
  auto counted = DescriptorShare::instance().take(owner, count);
  if (!counted) return {};
  const auto doorbells = fds.subspan(before, count);
  return {count == 1 ? Doorbell(std::move(doorbells[0]))
                     : Doorbell(std::move(doorbells[1]), std::move(doorbells[0])),
          std::move(counted)};
}

}  // namespace

void Announcements::on_announce(Connection& connection, Incoming& packet) {
  wire::Announcement announcement{};
  if (!packet.read(announcement)) return;
  std::size_t used = 0;
  std::shared_ptr<Peer> peer = peers_.use(announcement, packet.packet.fds(), used);
  bool linked = false;
  if (announcement.kind == Kind::publisher)
    linked = peer != nullptr && link_publisher(announcement, std::move(peer));
  else if (announcement.kind == Kind::subscription)
    linked = attach_subscription(announcement, peer, packet, used);
  if (linked || is_in_use(announcement) || packet.packet.descriptors_lost) return;
  say_unlinked(connection, announcement.kind, announcement.topic, announcement.index,
               announcement.generation);
  // This region was never mapped, so no later step will report it unmapped.
  if (!peers_.has({announcement.client, announcement.client_generation}))
    say_unlinked(connection, Kind::region, 0, announcement.client, announcement.client_generation);
}

bool Announcements::link_publisher(const wire::Announcement& announcement,
                                   std::shared_ptr<Peer> peer) {
  const auto subscription = endpoints_.subscription({announcement.topic, announcement.own_index},
                                                    announcement.own_generation);
  return subscription != nullptr &&
         subscription->add_publisher(
             {announcement.index, announcement.generation, announcement.extent,
              announcement.first_sequence, abi::unpack_qos(announcement.qos),
              announcement.from_start != 0, announcement.quota},
             std::move(peer));
}

/// `peer`: null if its memory cannot be mapped. The doorbells follow the first `used` descriptors.
bool Announcements::attach_subscription(const wire::Announcement& announcement,
                                        const std::shared_ptr<Peer>& peer, Incoming& packet,
                                        std::size_t used) {
  const auto publisher = endpoints_.publisher({announcement.topic, announcement.own_index},
                                              announcement.own_generation);
  if (publisher == nullptr) return false;  // it has ended meanwhile
  const PeerOwner owner = peers_.owner_of(announcement);
  const auto now = ReaderShares::Clock::now();
  UnmappedUsers& unmapped = readers_.unmapped_users();
  if (peer == nullptr) {
    const bool is_out = unmapped.is_out(owner, now);
    if (!is_out) unmapped.note(owner);
    publisher->note_unmapped({announcement.index, announcement.generation}, owner, is_out, now);
    return false;
  }
  const bool is_new = publisher->attach(
      {announcement.index, announcement.generation, announcement.extent, announcement.wait_set,
       owner, announcement.quota},
      peer, doorbell_among(packet.packet.fds(), used, announcement.doorbell_count, peer->owner()));
  if (is_new && readers_.shares().is_out(owner, now))
    publisher->withdraw({announcement.index, announcement.generation});
  return true;
}

/// Returns whether any endpoint of this process is linked: a report speaks for the whole process.
bool Announcements::is_in_use(const wire::Announcement& announcement) const {
  return announcement.kind == Kind::publisher
             ? endpoints_.is_linked(announcement.topic, announcement.index, announcement.generation)
             : endpoints_.is_attached(announcement.topic, announcement.index,
                                      announcement.generation);
}

void Announcements::on_window(Connection& connection, Incoming& packet) {
  wire::WindowAnnounced announced{};
  if (!packet.read(announced) || packet.packet.descriptor_count != 1) return;
  const PeerTable::Key process{announced.client, announced.client_generation};
  // Unmapped meanwhile: this announcement came later and voids the report, so report again.
  if (!peers_.has(process))
    return say_unlinked(connection, Kind::region, 0, process.first, process.second);
  peers_.add_window(process, {announced.window, announced.base, announced.bytes, announced.first},
                    std::move(packet.packet.fds()[0]));
}

void Announcements::on_forget(Connection& connection, Incoming& packet) {
  wire::Reference over{};
  if (!packet.read(over) || over.kind != Kind::subscription) return;
  for (const auto& publisher : endpoints_.publishers()) {
    if (publisher->topic_index() == over.topic) publisher->detach(over.index, over.generation);
  }
  say_unlinked(connection, Kind::subscription, over.topic, over.index, over.generation);
}

void Announcements::on_orphaned(Connection&, Incoming& packet) {
  wire::Orphaned gone{};
  if (!packet.read(gone)) return;
  endpoints_.for_each_subscription([&](const EndpointTable::Key& key, const auto& subscription) {
    if (key.first == gone.topic)
      subscription->orphan(gone.index, gone.generation, gone.final_head == 0);
  });
}

// A reader has other memory at the address of this heap, so the heap continues in another window.
void Announcements::on_move_heap(Connection&, Incoming& packet) {
  wire::MoveHeap move{};
  if (packet.read(move)) growth_.move_to(move.window);
}

void Announcements::on_kick(Connection&, Incoming& packet) {
  wire::Reference whose{};
  if (!packet.read(whose)) return;
  for (const auto& publisher : endpoints_.publishers()) {
    if (publisher->topic_index() == whose.topic && publisher->identity().index == whose.index)
      publisher->run_upkeep();
  }
}

namespace {

void tell(EndpointEvents& events, const wire::Notice& notice) noexcept {
  constexpr auto is_same = [](QosPolicyKind kind, abi::QosPolicy policy) {
    return static_cast<std::uint32_t>(kind) == static_cast<std::uint32_t>(policy);
  };
  static_assert(
      is_same(QosPolicyKind::durability, abi::QosPolicy::durability) &&
      is_same(QosPolicyKind::deadline, abi::QosPolicy::deadline) &&
      is_same(QosPolicyKind::liveliness, abi::QosPolicy::liveliness) &&
      is_same(QosPolicyKind::reliability, abi::QosPolicy::reliability) &&
      is_same(QosPolicyKind::liveliness_lease_duration, abi::QosPolicy::liveliness_lease));
  switch (static_cast<Errc>(notice.code)) {
    case Errc::qos_incompatible:
      events.incompatible_qos(static_cast<QosPolicyKind>(notice.policy));
      break;
    case Errc::type_mismatch:
      events.incompatible_type();
      break;
    case Errc::arena_occupied: {
      wire::Name text = notice.text;
      text.text[sizeof text.text - 1] = '\0';
      events.heap_collision(text.text);
      break;
    }
    default:
      break;  // a newer daemon may send unknown codes
  }
}

}  // namespace

void Announcements::on_notice(Connection&, Incoming& packet) {
  wire::Notice notice{};
  if (!packet.read(notice)) return;
  const EndpointTable::Key own{notice.topic, notice.index};
  if (notice.kind == Kind::publisher) {
    if (const auto here = endpoints_.publisher(own, notice.generation))
      tell(here->events(), notice);
  } else if (notice.kind == Kind::subscription) {
    if (const auto here = endpoints_.subscription(own, notice.generation))
      tell(here->events(), notice);
  }
}

}  // namespace agnocast
