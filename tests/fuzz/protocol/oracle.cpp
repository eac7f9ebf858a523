// SPDX-License-Identifier: Apache-2.0
//
// Oracle: see the header. Rule RU is checked in three places: no client gets a place that another
// process still knows (hello_served), no window is assigned that a process still has
// (window_given), no extent and no place of an endpoint that a process was notified of
// (create_served). At a creation and at a rejoin, exactly the endpoints that match are announced to
// each other (check_announced).

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

wire::Header header_of(const Oracle::Heard& packet) {
  wire::Header header;
  AGNOCAST_CHECK(packet.bytes.size() >= sizeof header);
  std::memcpy(&header, packet.bytes.data(), sizeof header);
  AGNOCAST_CHECK(header.bytes == packet.bytes.size());
  return header;
}

template <class Body>
Body read(const Oracle::Heard& packet) {
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

void Oracle::hear_answer(const Process& to, const wire::Header& header) {
  AGNOCAST_CHECK(&to == answer_.from && header.request == answer_.id);
  ++answer_.count;
}

void Oracle::hear(Process& to, const Heard& packet) {
  const wire::Header header = header_of(packet);
  switch (header.opcode) {
    case Opcode::welcome:
    case Opcode::rejoined:
    case Opcode::refused:
    case Opcode::window_opened:
    case Opcode::wait_set_opened:
    case Opcode::endpoint_created:
    case Opcode::done:
      hear_answer(to, header);
      break;
    default:
      break;
  }
  switch (header.opcode) {
    case Opcode::welcome: {
      answer_.welcome = read<wire::Welcome>(packet);
      AGNOCAST_CHECK(packet.fds.size() == 2);  // board and region
      to.greeted = true;
      to.region = std::move(Mapping::map(packet.fds[1].get(), answer_.welcome->client_region_bytes,
                                         Mapping::Access::read_write)
                                .value());
      break;
    }
    case Opcode::rejoined:
      answer_.rejoined = to.greeted = true;
      // All the following is about this connection.
      for (auto& [subject, notified] : to.notified) notified.packet = 0;
      for (auto& [owner, notified] : to.regions) notified.packet = 0;
      break;
    case Opcode::refused:
      answer_.refused = static_cast<Errc>(read<wire::Refused>(packet).code);
      break;
    case Opcode::revoked:
      if (!to.revoked) revoked(to);
      break;
    case Opcode::announce:
      hear_announcement(to, read<wire::Announcement>(packet), packet.fds.size());
      break;
    case Opcode::window_opened:
      AGNOCAST_CHECK(packet.fds.size() == 2);  // for writing and for reading
      answer_.window = read<wire::WindowOpened>(packet);
      break;
    case Opcode::window_announced: {
      const auto body = read<wire::WindowAnnounced>(packet);
      AGNOCAST_CHECK(packet.fds.size() == 1);
      AGNOCAST_CHECK(to.regions.count(body.client) == 1);
      to.regions[body.client].packet = to.packet_count;
      answer_.windows.push_back({&to, body.client, {body.base, body.base + body.bytes}});
      break;
    }
    case Opcode::endpoint_created:
      answer_.created = read<wire::EndpointCreated>(packet);
      break;
    case Opcode::done:
      answer_.done = true;
      break;
    case Opcode::region: {
      const auto body = read<wire::Reference>(packet);
      AGNOCAST_CHECK(body.kind == Kind::region);
      to.regions[body.index] = {to.packet_count, body.generation, body.index, {}, {}};
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

// Others may know a window before its owner does.
void Oracle::end_answer() {
  for (const Answer::NewWindow& one : answer_.windows) {
    if (!one.notified->revoked) one.notified->windows[one.owner].push_back(one.window);
  }
}

void Oracle::hear_announcement(Process& to, const wire::Announcement& body, std::size_t fd_count) {
  const bool publisher = body.kind == Kind::publisher;
  AGNOCAST_CHECK(fd_count == 1 + (publisher ? body.window_count : body.doorbell_count));
  const Notified notified{to.packet_count, body.generation, body.client,
                          extent_of(body.kind, body.extent), abi::unpack_qos(body.qos)};
  Notified& place = to.notified[{body.kind, body.topic, body.index}];
  AGNOCAST_CHECK(place.generation == 0 || place.generation == body.generation);
  place = notified;
  Notified& region = to.regions[body.client];
  AGNOCAST_CHECK(region.generation == 0 || region.generation == body.client_generation);
  region = {to.packet_count, body.client_generation, body.client, {}, {}};
  if (publisher) {
    auto& windows = to.windows[body.client];
    windows.clear();
    for (std::uint32_t w = 0; w < body.window_count; ++w)
      windows.push_back({body.window[w].base, body.window[w].base + body.window[w].bytes});
  }
  answer_.announced.insert({body.own_generation, body.generation});
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
      AGNOCAST_CHECK(answer_.announced.contains({own.generation, other.generation}) == match);
      if (in_both_directions && process.greeted)
        AGNOCAST_CHECK(answer_.announced.contains({other.generation, own.generation}) == match);
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
  ++answer_.own_count;
}

// --- the answer to a request

void Oracle::check_answered(const Request& request) const {
  const bool is_statement = std::holds_alternative<wire::Unlinked>(request) ||
                            std::holds_alternative<wire::Blocked>(request) ||
                            std::holds_alternative<wire::Withdrawn>(request) ||
                            std::holds_alternative<wire::CallbackGroup>(request) ||
                            std::holds_alternative<wire::CallbackThread>(request) ||
                            std::holds_alternative<wire::WatchGraph>(request);
  AGNOCAST_CHECK(answer_.count == 1 || (is_statement && answer_.count == 0));
}

void Oracle::hello_served(Process& who, const wire::Hello& request) const {
  if (!answer_.welcome) {
    AGNOCAST_CHECK(request.fingerprint != abi::fingerprint() || who.revoked ||
                   answer_.refused == Errc::limit_reached ||
                   answer_.refused == Errc::quota_exceeded);
    return;
  }
  AGNOCAST_CHECK(!who.revoked);
  const std::uint64_t client = answer_.welcome->client;
  for (const Process& process : processes_) {
    if (!process.client) continue;
    AGNOCAST_CHECK(number(*process.client) != client);
    AGNOCAST_CHECK(process.regions.count(client) == 0);
  }
  who.client = ClientIndex{static_cast<std::uint32_t>(client)};
  who.generation = answer_.welcome->client_generation;
}

void Oracle::rejoin_served(Process& who, const wire::Rejoin& request) const {
  const bool is_true = request.fingerprint == abi::fingerprint() &&
                       request.incarnation == incarnation && who.client &&
                       number(*who.client) == request.client &&
                       who.generation == request.client_generation;
  if (is_true && who.revoked) AGNOCAST_CHECK(answer_.refused == Errc::revoked);
  if (answer_.rejoined) {
    AGNOCAST_CHECK(is_true && !who.revoked);
    check_welcome_back(who);
  } else if (is_true && !who.revoked) {
    AGNOCAST_CHECK(answer_.refused == Errc::limit_reached);  // too often
  }
}

void Oracle::check_welcome_back(const Process& who) const {
  AGNOCAST_CHECK(answer_.own_count == who.own.size());
  for (const Endpoint& own : who.own) {
    if (!own.left) check_announced(who, own, false);
  }
  // A process is notified of its own region only with its endpoints.
  for (const auto& [owner, notified] : who.regions)
    AGNOCAST_CHECK(notified.packet != 0 || owner == number(*who.client));
}

void Oracle::window_served(Process& who) const {
  if (!answer_.window) return;
  const Range window = window_at(answer_.window->base);
  if (answer_.window->window < who.heap.size()) {
    AGNOCAST_CHECK(who.heap[answer_.window->window].from == window.from);
    return;
  }
  for (const Range& range : who.blocked) AGNOCAST_CHECK(!range.meets(window));
  window_given(who, window);
}

void Oracle::window_brought(Process& who, const wire::BringWindow& request, bool is_its_own) const {
  if (answer_.refused == Errc::permission_denied) AGNOCAST_CHECK(!is_its_own);
  if (!answer_.done) return;
  if (request.window < who.heap.size()) {
    AGNOCAST_CHECK(who.heap[request.window].from == request.base);
    return;
  }
  AGNOCAST_CHECK(is_its_own);
  window_given(who, window_at(request.base));
}

void Oracle::window_given(Process& who, const Range& window) const {
  for (const Process& process : processes_) {
    for (const Range& own : process.heap) AGNOCAST_CHECK(!own.meets(window));
    for (const auto& [client, windows] : process.windows) {
      for (const Range& other : windows) AGNOCAST_CHECK(!process.client || !other.meets(window));
    }
  }
  who.heap.push_back(window);
}

void Oracle::blocked(Process& who, const wire::Blocked& range) const {
  if (!answer_.refused) who.blocked.push_back({range.base, range.base + range.bytes});
}

const Endpoint* Oracle::created_before(const Process& who, const CreateRequest& request) {
  const auto found = std::find_if(who.own.begin(), who.own.end(), [&](const Endpoint& endpoint) {
    return endpoint.creation == request.request && endpoint.kind == request.kind;
  });
  return found == who.own.end() ? nullptr : &*found;
}

void Oracle::create_served(Process& who, const CreateRequest& request) {
  const wire::EndpointCreated& created = answer_.created;
  if (const Endpoint* const before = created_before(who, request)) {
    AGNOCAST_CHECK(created.generation == before->generation && created.index == before->index);
    return;
  }
  if (created.generation == 0) return;
  AGNOCAST_CHECK(created.generation > last_generation_);
  last_generation_ = created.generation;
  const Range extent = extent_of(request.kind, created.extent);
  AGNOCAST_CHECK(extent.from >= abi::page_bytes && extent.to <= abi::client_region_bytes);
  for (const Process& process : processes_) {
    if (!process.client) continue;
    const auto same = process.notified.find({request.kind, created.topic, created.index});
    if (same != process.notified.end())
      AGNOCAST_CHECK(same->second.generation == created.generation);
    for (const auto& [subject, notified] : process.notified) {
      if (notified.generation != created.generation && notified.owner == number(*who.client))
        AGNOCAST_CHECK(!notified.extent.meets(extent));
    }
  }
  for (const Endpoint& other : who.own) AGNOCAST_CHECK(!other.extent.meets(extent));
  who.created.insert(request.request);
  who.own.push_back({request.kind, created.topic, created.index, created.generation, extent,
                     request.qos, request.request, false});
  check_announced(who, who.own.back(), true);
}

void Oracle::leave_served(Process& who, const LeaveRequest& request) const {
  if (!answer_.done) return;
  const auto left = own_of(who, request.reference);
  AGNOCAST_CHECK(request.again || (left != who.own.end() && !left->left));
  if (left != who.own.end()) left->left = true;
}

// docs/control-plane.md, leaving: the other effects of a `drained`.
void Oracle::drained_served(Process& who, const DrainedRequest& request) const {
  if (!answer_.done) return;
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

void Oracle::unlinked(Process& who, const wire::Unlinked& statement) const {
  if (answer_.refused) return;
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

void Oracle::observer_served(const Request& request) const {
  const std::vector<Opcode>& bodies = answer_.observed;
  AGNOCAST_CHECK(!bodies.empty());
  if (bodies.front() == Opcode::refused) return;
  if (std::holds_alternative<wire::Dump>(request)) check_whole(Opcode::dump_end);
  if (std::holds_alternative<wire::ReadJournal>(request)) check_whole(Opcode::journal_end);
  const auto* const revocation = std::get_if<wire::Revoke>(&request);
  if (revocation == nullptr) return;
  for (Process& process : processes_) {
    if (process.client && number(*process.client) == revocation->client)
      AGNOCAST_CHECK(process.generation == revocation->generation && process.revoked);
  }
}

void Oracle::check_whole(Opcode last) const {
  const std::vector<Opcode>& bodies = answer_.observed;
  AGNOCAST_CHECK(std::count(bodies.begin(), bodies.end(), last) == 1 && bodies.back() == last);
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
