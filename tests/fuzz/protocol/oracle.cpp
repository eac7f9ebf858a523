// SPDX-License-Identifier: Apache-2.0
//
// Oracle: see the header. Rule RU is checked in three places: no client gets a place that another
// process still knows (greeted), no window is assigned that a process still has (window_given), no
// extent and no place of an endpoint that a process was notified of (create_served). At a creation
// and at a rejoin, exactly the endpoints that match are announced to each other (check_announced).

#include <tests/fuzz/protocol/oracle.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/check.hpp>
#include <daemon/state/registry.hpp>

#include <algorithm>
#include <cstring>
#include <iterator>

namespace agnocast::daemon::fuzz {

namespace {

Range extent_of(Kind kind, std::uint64_t at) {
  return {at, at + (kind == Kind::publisher ? abi::publisher_extent_bytes
                                            : abi::subscription_extent_bytes(1))};
}

wire::Header header_of(const Outgoing& packet) {
  wire::Header header;
  AGNOCAST_CHECK(packet.bytes.size() >= sizeof header);
  AGNOCAST_CHECK(packet.bytes.size() <= wire::packet_bytes_max);
  std::memcpy(&header, packet.bytes.data(), sizeof header);
  AGNOCAST_CHECK(header.bytes == packet.bytes.size());
  AGNOCAST_CHECK(packet.fds.size() <= wire::descriptor_count_max);
  for (const SharedFd& fd : packet.fds) AGNOCAST_CHECK(fd != nullptr && fd->get() >= 0);
  return header;
}

template <class Body>
Body read(const Outgoing& packet) {
  AGNOCAST_CHECK(packet.bytes.size() == sizeof(Body));
  Body body;
  std::memcpy(static_cast<void*>(&body), packet.bytes.data(), sizeof body);
  return body;
}

std::vector<Endpoint>::iterator own_of(Process& who, const wire::Reference& reference) {
  return std::find_if(who.own.begin(), who.own.end(), [&](const Endpoint& endpoint) {
    return endpoint.kind == reference.kind && endpoint.topic == reference.topic &&
           endpoint.index == reference.index && endpoint.generation == reference.generation;
  });
}

auto own_of(const Process& who, std::uint64_t generation) {
  return std::find_if(who.own.begin(), who.own.end(),
                      [&](const Endpoint& endpoint) { return endpoint.generation == generation; });
}

/// Returns whether an endpoint of `own_client` and one of `client` match.
bool do_match(const Endpoint& own, std::uint64_t own_client, const abi::Qos& qos,
              std::uint64_t client) {
  const abi::QosOf mine{own.qos, own_client}, other{qos, client};
  return own.kind == Kind::publisher ? abi::endpoints_match(mine, other)
                                     : abi::endpoints_match(other, mine);
}

/// Returns whether a statement is about this notification, and not about an older announcement.
bool is_about(const wire::Unlinked& statement, const Notified& notified) {
  return notified.generation == statement.generation && notified.packet <= statement.seen;
}

}  // namespace

// --- what the daemon sends

void Oracle::hear(Process& to, std::uint64_t number, const Outgoing& packet) {
  switch (header_of(packet).opcode) {
    case Opcode::announce:
      hear_announcement(to, read<wire::Announcement>(packet), number, packet.fds.size());
      break;
    case Opcode::window_announced: {
      const auto body = read<wire::WindowAnnounced>(packet);
      AGNOCAST_CHECK(packet.fds.size() == 1);
      AGNOCAST_CHECK(to.regions.count(body.client) == 1);
      to.regions[body.client].packet = number;
      to.windows[body.client].push_back({body.base, body.base + body.bytes});
      break;
    }
    case Opcode::endpoint_created:
      created_ = read<wire::EndpointCreated>(packet);
      break;
    case Opcode::done:
      done_ = true;
      break;
    case Opcode::region: {
      const auto body = read<wire::Reference>(packet);
      AGNOCAST_CHECK(body.kind == Kind::region);
      to.regions[body.index] = {number, body.generation, body.index, {}, {}};
      break;
    }
    case Opcode::own:
      hear_own(to, read<wire::Own>(packet));
      break;
    case Opcode::forget:
      AGNOCAST_CHECK(read<wire::Reference>(packet).kind == Kind::subscription);
      break;
    default:
      break;
  }
}

void Oracle::hear_announcement(Process& to, const wire::Announcement& body, std::uint64_t packet,
                               std::size_t fd_count) {
  const bool publisher = body.kind == Kind::publisher;
  AGNOCAST_CHECK(fd_count == 1 + (publisher ? body.window_count : body.doorbell_count));
  const Notified notified{packet, body.generation, body.client, extent_of(body.kind, body.extent),
                          abi::unpack_qos(body.qos)};
  Notified& place = to.notified[{body.kind, body.topic, body.index}];
  AGNOCAST_CHECK(place.generation == 0 || place.generation == body.generation);
  place = notified;
  Notified& region = to.regions[body.client];
  AGNOCAST_CHECK(region.generation == 0 || region.generation == body.client_generation);
  region = {packet, body.client_generation, body.client, {}, {}};
  if (publisher) {
    auto& windows = to.windows[body.client];
    windows.clear();
    for (std::uint32_t w = 0; w < body.window_count; ++w)
      windows.push_back({body.window[w].base, body.window[w].base + body.window[w].bytes});
  }
  announced_.insert({body.own_generation, body.generation});
  // It is for an endpoint of the addressed process, and the two match.
  const auto own = own_of(to, body.own_generation);
  if (own == to.own.end()) return;  // it is being created: create_served() checks
  AGNOCAST_CHECK(own->topic == body.topic && own->index == body.own_index &&
                 own->kind != body.kind);
  AGNOCAST_CHECK(do_match(*own, number(*to.client), notified.qos, notified.owner));
}

void Oracle::check_announced(const Process& who, const Endpoint& own,
                             bool in_both_directions) const {
  for (const Process& process : processes_) {
    for (const Endpoint& other : process.own) {
      if (other.topic != own.topic || other.kind == own.kind || other.left) continue;
      const bool match = do_match(own, number(*who.client), other.qos, number(*process.client));
      AGNOCAST_CHECK(announced_.contains({own.generation, other.generation}) == match);
      if (in_both_directions && process.session)
        AGNOCAST_CHECK(announced_.contains({other.generation, own.generation}) == match);
    }
  }
}

void Oracle::hear_own(const Process& to, const wire::Own& body) {
  const auto known = own_of(to, body.generation);
  if (known == to.own.end()) {
    // Drained, but another process has not acknowledged yet: its process reports it again.
    AGNOCAST_CHECK(to.drained.count(body.generation) == 1 && body.active == 0);
    return;
  }
  AGNOCAST_CHECK(known->creation == body.creation && known->left == (body.active == 0));
  ++own_reported_;
}

void Oracle::check_whole(const std::vector<Outgoing>& packets, Opcode last) {
  AGNOCAST_CHECK(!packets.empty());
  for (const Outgoing& packet : packets)
    AGNOCAST_CHECK((header_of(packet).opcode == last) == (&packet == &packets.back()));
}

// --- the result of a request

void Oracle::greeted(Process& who, ClientIndex client, std::uint64_t generation) {
  for (const Process& process : processes_) {
    AGNOCAST_CHECK(process.client != client);
    if (process.client) AGNOCAST_CHECK(process.regions.count(number(client)) == 0);
  }
  who.client = client;
  who.generation = generation;
}

void Oracle::check_rejoin(const Process& who, const wire::Rejoin& request,
                          journal::RejoinDecision decision) const {
  const bool is_true = request.fingerprint == abi::fingerprint() &&
                       request.incarnation == incarnation && who.client &&
                       number(*who.client) == request.client &&
                       who.generation == request.client_generation;
  if (is_true && who.revoked) AGNOCAST_CHECK(decision == journal::RejoinDecision::revoked);
  AGNOCAST_CHECK((decision == journal::RejoinDecision::take_back) == (is_true && !who.revoked));
}

void Oracle::begin_welcome_back(Process& who) {
  for (auto& [subject, notified] : who.notified) notified.packet = 0;
  for (auto& [owner, notified] : who.regions) notified.packet = 0;
  own_reported_ = 0;
}

void Oracle::end_welcome_back(const Process& who) const {
  AGNOCAST_CHECK(own_reported_ == who.own.size());
  for (const Endpoint& own : who.own) {
    if (!own.left) check_announced(who, own, false);
  }
  // A process is notified of its own region only with its endpoints.
  for (const auto& [owner, notified] : who.regions)
    AGNOCAST_CHECK(notified.packet != 0 || owner == number(*who.client));
}

void Oracle::check_not_blocked(const Process& who, const Range& window) {
  for (const Range& blocked : who.blocked) AGNOCAST_CHECK(!blocked.meets(window));
}

void Oracle::window_given(Process& who, const Range& window) {
  for (const Process& process : processes_) {
    for (const Range& own : process.heap) AGNOCAST_CHECK(!own.meets(window));
    for (const auto& [client, windows] : process.windows) {
      for (const Range& other : windows) AGNOCAST_CHECK(!process.client || !other.meets(window));
    }
  }
  who.heap.push_back(window);
}

const Endpoint* Oracle::created_before(const Process& who, const CreateRequest& request) const {
  const auto found = std::find_if(who.own.begin(), who.own.end(), [&](const Endpoint& endpoint) {
    return endpoint.creation == request.request && endpoint.kind == request.kind;
  });
  return found == who.own.end() ? nullptr : &*found;
}

void Oracle::check_answered_again(const Endpoint& endpoint) const {
  AGNOCAST_CHECK(created_.generation == endpoint.generation && created_.index == endpoint.index);
}

void Oracle::create_served(Process& who, const CreateRequest& request, bool was_made) {
  if (!was_made) {
    AGNOCAST_CHECK(created_.generation == 0);
    return;
  }
  AGNOCAST_CHECK(created_.generation > last_generation_);
  last_generation_ = created_.generation;
  const Range extent = extent_of(request.kind, created_.extent);
  AGNOCAST_CHECK(extent.from >= abi::page_bytes && extent.to <= abi::client_region_bytes);
  for (const Process& process : processes_) {
    if (!process.client) continue;
    const auto same = process.notified.find({request.kind, created_.topic, created_.index});
    if (same != process.notified.end())
      AGNOCAST_CHECK(same->second.generation == created_.generation);
    for (const auto& [subject, notified] : process.notified) {
      if (notified.generation != created_.generation && notified.owner == number(*who.client))
        AGNOCAST_CHECK(!notified.extent.meets(extent));
    }
  }
  for (const Endpoint& other : who.own) AGNOCAST_CHECK(!other.extent.meets(extent));
  who.created.insert(request.request);
  who.own.push_back({request.kind, created_.topic, created_.index, created_.generation, extent,
                     request.qos, request.request, false});
  check_announced(who, who.own.back(), true);
}

void Oracle::leave_served(Process& who, const LeaveRequest& request, bool accepted) const {
  AGNOCAST_CHECK(accepted == done_);
  if (!accepted) return;
  const auto left = own_of(who, request.reference);
  AGNOCAST_CHECK(request.again || (left != who.own.end() && !left->left));
  if (left != who.own.end()) left->left = true;
}

// docs/control-plane.md, leaving: the other effects of a `drained`.
void Oracle::drained_served(Process& who, const DrainedRequest& request, bool accepted) const {
  AGNOCAST_CHECK(accepted == done_);
  if (!accepted) return;
  const auto gone = own_of(who, request.reference);
  if (request.again && gone == who.own.end()) return;
  AGNOCAST_CHECK(gone != who.own.end() && gone->left);
  const Endpoint endpoint = *gone;
  who.drained.insert(endpoint.generation);
  who.own.erase(gone);
  const Kind others = endpoint.kind == Kind::publisher ? Kind::subscription : Kind::publisher;
  for (auto at = who.notified.begin(); at != who.notified.end();) {
    const auto& [subject, notified] = *at;
    bool over = subject.kind == others && subject.topic == endpoint.topic;
    for (const Endpoint& other : who.own) {
      if (!over || other.topic != endpoint.topic || other.kind != endpoint.kind) continue;
      over = others == Kind::publisher &&
             !do_match(other, number(*who.client), notified.qos, notified.owner);
    }
    at = over ? who.notified.erase(at) : std::next(at);
  }
}

void Oracle::unlinked(Process& who, const wire::Unlinked& statement) {
  if (statement.kind == Kind::region) {
    const auto found = who.regions.find(statement.index);
    if (found == who.regions.end() || !is_about(statement, found->second)) return;
    who.regions.erase(found);
    who.windows.erase(statement.index);
    return;
  }
  const auto found = who.notified.find({statement.kind, statement.topic, statement.index});
  if (found != who.notified.end() && is_about(statement, found->second)) who.notified.erase(found);
}

void Oracle::revoked(Process& who) {
  who.revoked = true;
  who.notified.clear();
  who.regions.clear();
  who.windows.clear();
  who.own.clear();
  who.drained.clear();
  who.created.clear();
  who.blocked.clear();
}

}  // namespace agnocast::daemon::fuzz
