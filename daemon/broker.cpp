// SPDX-License-Identifier: Apache-2.0

#include <daemon/broker.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <agnocast/version.hpp>
#include <base/check.hpp>
#include <base/clock.hpp>
#include <base/names.hpp>
#include <base/step.hpp>
#include <daemon/flight_recorder.hpp>
#include <journal/cases.hpp>

#include <fcntl.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <type_traits>
#include <utility>

namespace agnocast::daemon {

using journal::DeathReason;

namespace {

// Packets of one connection handled in a row; the others must not wait for a flood.
constexpr unsigned packets_per_turn = 32;
// Likewise connections: whoever connects again and again, refused or not, is never done.
constexpr unsigned connections_per_turn = 8;
// How often a process without a connection is looked at.
constexpr int short_interval_ms = 250;
// How often holds are looked at, and observers.
constexpr int watch_interval_ms = 1'000;

// What an observer has not read by then is thrown away, and the observer with it.
constexpr std::uint64_t observer_patience_ms = 5'000;

std::uint64_t now_ms() noexcept { return monotonic_ns() / 1'000'000; }

// The enumerator's own word: what explain and the documentation list.
const char* word_of(Errc code) noexcept {
  switch (code) {
    case Errc::ok:
      return "ok";
#define AGNOCAST_ERROR_WORD(name, sentence, remedy) \
  case Errc::name:                                  \
    return #name;
      AGNOCAST_ERROR_TABLE(AGNOCAST_ERROR_WORD)
#undef AGNOCAST_ERROR_WORD
  }
  return "?";
}

// To a connection that is not taken: it is closed afterwards, but not without a word.
void send_refused(const PacketSocket& socket, Errc code, std::string_view text) noexcept {
  auto packet = make_body<wire::Refused>(wire::Opcode::refused);
  packet.code = static_cast<std::uint32_t>(code);
  packet.text = name_of(text);
  static_cast<void>(socket.send(packet_of(packet)));
}

const char* name_of_kind(Kind kind) noexcept {
  return kind == Kind::publisher ? "publisher" : "subscription";
}

}  // namespace

Broker::Broker(const BrokerOptions& options, Log& log, Dispatcher& dispatcher, Listener& listener,
               Regions regions, DescriptorStore& store)
    : options_(options),
      log_(log),
      dispatcher_(dispatcher),
      listener_(listener),
      store_(store),
      regions_(std::move(regions)),
      registry_(regions_.memory(), {options.config.limits.clients, options.config.limits.topics,
                                    options.config.limits.publishers_per_topic,
                                    options.config.limits.subscriptions_per_topic,
                                    options.config.limits.slots_per_publisher}),
      plan_(options.arena),
      obstacles_(options.arena),
      doorbells_(listener.bells_directory(), store),
      membership_(registry_, regions_, doorbells_, *this),
      hold_watch_(registry_, regions_),
      by_client_(abi::client_count_max, nullptr),
      spare_(::open("/dev/null", O_RDONLY | O_CLOEXEC)) {
  membership_.on_ended = [this](ClientIndex client) { on_ended(client); };
  membership_.on_matched = [this](const EndpointRef& publisher, const EndpointRef& subscription) {
    look_for_collision(publisher, subscription);
  };
}

Result<void> Broker::found(std::uint64_t incarnation) {
  const Arena& arena = options_.arena;
  registry_.create(incarnation, {arena.base, arena.bytes, arena.window_bytes, monotonic_ns(),
                                 listener_.bells_directory()});
  if (auto kept = regions_.keep(); !kept) return kept;
  return listener_.keep(store_);
}

Broker::~Broker() {
  dispatcher_.remove(listening_);
  for (auto& [id, peer] : peers_) {
    dispatcher_.remove(peer->connection);
    dispatcher_.remove(peer->process);
  }
}

Result<void> Broker::start() {
  const auto token =
      dispatcher_.add(listener_.socket().fd(), EPOLLIN, [this](std::uint32_t) { accept_all(); });
  if (!token) return tl::unexpected(token.error());
  listening_ = *token;
  return {};
}

// --- connections

void Broker::accept_all() {
  for (unsigned turn = 0; turn < connections_per_turn; ++turn) {
    auto socket = listener_.socket().accept();
    if (!socket) {
      if (socket.error().os_errno == EMFILE || socket.error().os_errno == ENFILE) {
        turn_away();
      } else {
        log_.write_limited("accept", LogLevel::warning, "connection not accepted",
                           {{"errno", socket.error().os_errno}});
      }
      return;  // level-triggered: what waits is told again
    }
    if (!*socket) return;
    accept(std::move(**socket));
  }
}

void Broker::turn_away() {
  ++registry_.counters().connections_refused;
  spare_.reset();
  {
    auto socket = listener_.socket().accept();
    if (socket && *socket)
      send_refused(**socket, Errc::limit_reached, "the daemon has no descriptor left");
  }
  spare_.reset(::open("/dev/null", O_RDONLY | O_CLOEXEC));
  log_.write_limited("descriptors", LogLevel::error, "connection refused",
                     {{"why", "no descriptor left; raise LimitNOFILE"}});
}

void Broker::accept(PacketSocket socket) {
  auto identity = identify_peer(socket.fd());
  if (!identity) {
    log_.write_limited("identify", LogLevel::warning, "connection refused",
                       {{"why", identity.error().what}, {"errno", identity.error().os_errno}});
    send_refused(socket, identity.error().code, identity.error().what);
    return;
  }
  AGNOCAST_CRASH_POINT(B_accepted);
  const std::uint32_t uid = identity->uid;
  Connections& used = connections_[uid];
  // Who has all the clients he may have can still look at them: such a connection can only observe.
  // Processes that have lost their connection may come back.
  const bool only_observes = used.clients >= options_.config.quota.clients + used.detached;
  if (only_observes && used.observers >= abi::observer_count_max) {
    ++registry_.counters().connections_refused;
    send_refused(socket, Errc::quota_exceeded, clients_text());
    log_.write_limited("connections uid=" + std::to_string(uid), LogLevel::warning,
                       "connection refused",
                       {{"uid", uid},
                        {"code", "quota_exceeded"},
                        {"limit", "[quota] clients"},
                        {"value", options_.config.quota.clients}});
    return;
  }
  const PeerId id = ++last_peer_;
  auto peer = std::make_unique<Peer>(Peer{id, Session(std::move(socket), std::move(*identity))});
  if (peer->session.identity().pid > 0) {
    peer->session.user_namespace =
        agnocast::user_namespace_of(peer->session.identity().pid).value_or(0);
  }
  const auto connection = dispatcher_.add(peer->session.socket().fd(), EPOLLIN,
                                          [this, id](std::uint32_t) { on_readable(id); });
  const auto process = !connection
                           ? connection
                           : dispatcher_.add(peer->session.identity().process.fd(), EPOLLIN,
                                             [this, id](std::uint32_t) { on_process_end(id); });
  if (!process) {
    if (connection) dispatcher_.remove(*connection);
    send_refused(peer->session.socket(), process.error().code, process.error().what);
    return;
  }
  peer->connection = *connection;
  peer->process = *process;
  peer->counts_as_observer = only_observes;
  ++(only_observes ? used.observers : used.clients);
  peers_.emplace(id, std::move(peer));
}

void Broker::on_readable(PeerId id) {
  std::array<std::byte, wire::packet_bytes_max> buffer;
  for (unsigned turn = 0; turn < packets_per_turn; ++turn) {
    const auto found = peers_.find(id);
    if (found == peers_.end() || found->second->session.closed()) return;
    Peer& peer = *found->second;
    if (peer.revoked) {
      say_farewell(peer);
      return;
    }
    const bool observes = peer.session.role() == Role::observer;
    if (observes && turn > 0) return;  // a dump is work
    // A blocked writer is woken here as well: the handler does not tell the events apart.
    if (peer.wants_writable && turn == 0) {
      flush(peer);
      if (peers_.find(id) == peers_.end() || peer.session.closed()) return;
    }
    auto packet = peer.session.socket().receive(buffer);
    if (!packet) {
      disconnect(peer, packet.error().what);
      return;
    }
    if (packet->kind == Packet::Kind::nothing) return;
    if (packet->kind == Packet::Kind::end) {
      disconnect(peer, "closed by the process");
      return;
    }
    if (packet->credentials && !peer.session.identity().confirmed)
      confirm(peer.session.identity(), *packet->credentials);
    if (observes && peer.session.has_output()) {
      disconnect(peer, "an observer asks before it has read");
      return;
    }
    AGNOCAST_CRASH_POINT(B_request);
    const Envelope envelope{packet->descriptor_count, packet->truncated, packet->descriptors_lost};
    serve(peer, decode({buffer.data(), packet->bytes}, envelope, peer.session.role()));
  }
}

void Broker::on_process_end(PeerId id) {
  const auto found = peers_.find(id);
  if (found == peers_.end()) return;
  reap_peer(*found->second, DeathReason::died, "process ended");
}

void Broker::flush(Peer& peer) {
  switch (peer.session.flush()) {
    case Session::Flushed::all:
      if (peer.wants_writable) dispatcher_.change(peer.connection, EPOLLIN);
      peer.wants_writable = false;
      break;
    case Session::Flushed::blocked:
      if (!peer.wants_writable) dispatcher_.change(peer.connection, EPOLLIN | EPOLLOUT);
      peer.wants_writable = true;
      break;
    case Session::Flushed::later:
      flush_later_ = true;
      break;
    case Session::Flushed::gone:
      peer.session.drop_output();
      break;
    case Session::Flushed::over:
      // Not here: the caller may be in the middle of an announcement. The connection is shut, and
      // its end is read like any other.
      log_.write_limited("output uid=" + std::to_string(peer.session.identity().uid),
                         LogLevel::warning, "connection ended",
                         {{"pid", peer.session.identity().pid},
                          {"uid", peer.session.identity().uid},
                          {"queued", peer.session.queued_count()},
                          {"why", "the process does not read"}});
      ::shutdown(peer.session.socket().fd(), SHUT_RDWR);
      peer.session.drop_output();
      break;
  }
}

void Broker::disconnect(Peer& peer, std::string_view why) {
  AGNOCAST_CRASH_POINT(B_ended);
  dispatcher_.remove(peer.connection);
  peer.connection = 0;
  peer.session.close();
  if (!peer.session.greeted()) {
    if (peer.session.role() == Role::observer)
      log_.write(LogLevel::debug, "observer gone",
                 {{"pid", peer.session.identity().pid}, {"why", why}});
    drop(peer.id);
    return;
  }
  const ClientIndex client = *peer.session.client();
  log_.write(LogLevel::debug, "connection ended",
             {{"client", number(client)}, {"pid", peer.session.identity().pid}, {"why", why}});
  // After exec, or when the library was shut down, nothing of the region is left in the process.
  if (!maps_file(peer.session.identity().pid, regions_.region_file(client))) {
    reap_peer(peer, DeathReason::let_go, "process let go of its region");
    return;
  }
  peer.detached = true;
  ++detached_count_;
  ++connections_[peer.session.identity().uid].detached;
}

void Broker::reap_peer(Peer& peer, DeathReason reason, std::string_view how) {
  AGNOCAST_CRASH_POINT(B_reap);
  const PeerId id = peer.id;
  if (!peer.session.greeted()) {
    drop(id);
    return;
  }
  const ClientIndex client = *peer.session.client();
  const bool revoked = peer.revoked;
  by_client_[number(client)] = nullptr;
  drop(id);
  if (revoked) {
    // The rest was done when it was revoked; now its place may be used again.
    registry_.client_died(client, reason);
    store_.remove(DescriptorStore::process(client));
    const ClientRecord& record = registry_.client(client);
    note(LogLevel::info, record.uid, "client gone",
         {{"client", number(client)},
          {"pid", record.pid},
          {"uid", record.uid},
          {"how", how},
          {"was", "revoked"}});
    membership_.settle_client(client);
    return;
  }
  repair(client, reason, how);
}

void Broker::repair(ClientIndex client, DeathReason reason, std::string_view how) {
  const std::uint32_t uid = registry_.client(client).uid;
  const std::uint32_t pid = registry_.client(client).pid;
  obstacles_.forget(client);
  const Reaped reaped = reap(client, reason, registry_, regions_, doorbells_, membership_);
  if (!registry_.is_revoked(client)) store_.remove(DescriptorStore::process(client));
  note(reaped.corrupt == 0 ? LogLevel::info : LogLevel::warning, uid, "client gone",
       {{"client", number(client)},
        {"pid", pid},
        {"uid", uid},
        {"how", how},
        {"publishers", reaped.publishers},
        {"subscriptions", reaped.subscriptions},
        {"rolled_back", reaped.rolled_back},
        {"rolled_forward", reaped.rolled_forward},
        {"corrupt_intents", reaped.corrupt}});
}

// Until the process ends the peer stays, and with it the connection's place in its user's quota and
// the pidfd: so long the process has its memory, and may not come back.
void Broker::revoke(Peer& peer, const std::string& why) {
  const ClientIndex client = *peer.session.client();
  by_client_[number(client)] = nullptr;
  peer.revoked = true;
  if (!std::exchange(peer.detached, true)) {
    ++detached_count_;
    ++connections_[peer.session.identity().uid].detached;
  }
  obstacles_.forget(client);
  const Reaped reaped =
      reap(client, DeathReason::revoked, registry_, regions_, doorbells_, membership_);
  log_.write(LogLevel::warning, "client revoked",
             {{"client", number(client)},
              {"pid", peer.session.identity().pid},
              {"uid", peer.session.identity().uid},
              {"why", why},
              {"publishers", reaped.publishers},
              {"subscriptions", reaped.subscriptions}});
  if (peer.session.closed()) return;
  // What waits for it is about a membership that it does not have any more.
  peer.session.drop_output();
  auto packet = make_body<wire::Refused>(wire::Opcode::revoked);
  packet.code = static_cast<std::uint32_t>(Errc::revoked);
  packet.text = name_of(why);
  peer.session.push(packet_of(packet), {});
  say_farewell(peer);
}

void Broker::say_farewell(Peer& peer) {
  if (peer.session.flush() == Session::Flushed::blocked) {
    dispatcher_.change(peer.connection, EPOLLOUT);  // nothing that it says is read any more
    return;
  }
  dispatcher_.remove(peer.connection);
  peer.connection = 0;
  // Not closed: what of its requests was never read would cost it the packet that waits for it.
  ::shutdown(peer.session.socket().fd(), SHUT_RDWR);
}

bool Broker::was_revoked(const Peer& peer) const {
  const PeerIdentity& who = peer.session.identity();
  for (const auto& [id, other] : peers_) {
    if (!other->revoked) continue;
    const PeerIdentity& one = other->session.identity();
    const auto inode = who.process.inode(), its_inode = one.process.inode();
    // A process that has not ended keeps its pid.
    const bool same = inode && its_inode
                          ? *inode == *its_inode
                          : who.pid > 0 && who.pid == one.pid && !one.process.ended();
    // After exec it is another program.
    if (same && maps_file(one.pid, regions_.region_file(*other->session.client()))) return true;
  }
  return false;
}

void Broker::drop(PeerId id) {
  const auto found = peers_.find(id);
  AGNOCAST_CHECK(found != peers_.end());
  Peer& peer = *found->second;
  dispatcher_.remove(peer.connection);
  dispatcher_.remove(peer.process);
  const auto user = connections_.find(peer.session.identity().uid);
  AGNOCAST_CHECK(user != connections_.end());
  std::uint64_t& count = peer.counts_as_observer ? user->second.observers : user->second.clients;
  AGNOCAST_CHECK(count > 0);
  --count;
  if (peer.detached) {
    --detached_count_;
    --user->second.detached;
  }
  if (user->second.clients + user->second.observers == 0) connections_.erase(user);
  if (peer.session.role() == Role::observer) --observer_count_;
  peers_.erase(found);
}

void Broker::tick() {
  const std::uint64_t now = now_ms();
  if (now - looked_ms_ < short_interval_ms) return;  // however many events there are
  looked_ms_ = now;
  if (flush_later_) {
    flush_later_ = false;
    for (auto& [id, peer] : peers_) {
      if (!peer->session.closed() && !peer->revoked && peer->session.has_output()) flush(*peer);
    }
  }
  if (detached_count_ > 0) {
    std::vector<PeerId> gone;
    for (const auto& [id, peer] : peers_) {
      if (peer->detached &&
          !maps_file(peer->session.identity().pid, regions_.region_file(*peer->session.client())))
        gone.push_back(id);
    }
    for (const PeerId id : gone)
      reap_peer(*peers_.at(id), DeathReason::let_go, "process let go of its region");
  }
  drop_slow_observers(now);
  watch_holds(now);
  log_.flush();
}

int Broker::due_ms() const noexcept {
  if (detached_count_ > 0 || flush_later_) return short_interval_ms;
  return peers_.empty() ? 10'000 : watch_interval_ms;
}

void Broker::drop_slow_observers(std::uint64_t now) {
  if (observer_count_ == 0) return;
  std::vector<PeerId> slow;
  for (const auto& [id, peer] : peers_) {
    if (peer->session.role() == Role::observer && peer->session.has_output() &&
        now - peer->asked_ms > observer_patience_ms)
      slow.push_back(id);
  }
  for (const PeerId id : slow) disconnect(*peers_.at(id), "an observer does not read");
}

void Broker::watch_holds(std::uint64_t now) {
  if (now - watched_ms_ < watch_interval_ms) return;
  watched_ms_ = now;
  const auto liar = hold_watch_.look();
  if (!liar) return;
  Peer* const peer = by_client_[number(registry_.owner_of(liar->subscription))];
  if (peer == nullptr) return;
  revoke(*peer, "its subscription to " +
                    std::string(registry_.topic(liar->subscription.topic).name) + " holds " +
                    std::to_string(liar->held) + " messages of one publisher, its quota is " +
                    std::to_string(liar->quota));
}

// --- Post

Session* Broker::session_of(ClientIndex client) {
  Peer* const peer = by_client_[number(client)];
  return peer == nullptr || peer->session.closed() ? nullptr : &peer->session;
}

std::uint64_t Broker::user_namespace_of(ClientIndex client) {
  const Peer* const peer = by_client_[number(client)];
  return peer == nullptr ? 0 : peer->session.user_namespace;
}

void Broker::send(ClientIndex client, std::span<const std::byte> packet,
                  std::vector<SharedFd> fds) {
  Peer* const peer = by_client_[number(client)];
  if (peer == nullptr || peer->session.closed()) return;
  reply(*peer, packet, std::move(fds));
}

void Broker::reply(Peer& peer, std::span<const std::byte> packet, std::vector<SharedFd> fds) {
  AGNOCAST_CRASH_POINT(B_send);
  const bool waiting = peer.session.has_output();
  peer.session.push(packet, std::move(fds));
  // While something waits for the socket there is nothing to gain from another try.
  if (!waiting || peer.session.queued_count() > Session::queue_count_max) flush(peer);
  AGNOCAST_CRASH_POINT(B_sent);
}

void Broker::note(LogLevel level, std::uint32_t uid, std::string_view event, Log::Fields fields) {
  if (log_.is_written(LogLevel::debug)) {
    log_.write(level, event, fields);
  } else {
    log_.write_limited(std::string(event) + " uid=" + std::to_string(uid), level, event, fields);
  }
}

// --- requests

tl::unexpected<Failure> Broker::refusal(Errc code, const std::string& text) {
  return fail_with(code, text);
}

std::string Broker::clients_text() const {
  return "[quota] clients is " + std::to_string(options_.config.quota.clients) +
         ", this user has as many";
}

Result<void> Broker::check_limit(std::uint64_t used, std::uint64_t more, std::uint64_t limit,
                                 std::string_view name) {
  if (used <= limit && more <= limit - used) return {};
  return refusal(Errc::quota_exceeded, std::string(name) + " is " + std::to_string(limit) +
                                           ", this user has " + std::to_string(used) +
                                           " and asks for " + std::to_string(more) + " more");
}

void Broker::refuse(Peer& peer, std::uint64_t request, Errc code, int os_errno,
                    std::string_view text) {
  auto packet = make_body<wire::Refused>(wire::Opcode::refused, request);
  packet.code = static_cast<std::uint32_t>(code);
  packet.os_errno = static_cast<std::uint32_t>(os_errno);
  packet.text = name_of(text);
  const std::uint32_t uid = peer.session.identity().uid;
  ++registry_.counters().requests_refused;
  log_.write_limited("refused uid=" + std::to_string(uid), LogLevel::warning, "request refused",
                     {{"pid", peer.session.identity().pid},
                      {"uid", uid},
                      {"code", word_of(code)},
                      {"errno", os_errno},
                      {"why", text}});
  reply(peer, packet_of(packet));
}

void Broker::serve(Peer& peer, const Request& request) {
  Result<void> served;
  std::uint64_t id = 0;
  const auto handle = [&](const auto& body) {
    using Body = std::decay_t<decltype(body)>;
    if constexpr (std::is_same_v<Body, wire::Hello>) {
      id = body.header.request;
      served = hello(peer, body);
    } else if constexpr (std::is_same_v<Body, wire::Rejoin>) {
      id = body.header.request;
      served = rejoin(peer, body);
    } else if constexpr (std::is_same_v<Body, wire::WindowRequest>) {
      id = body.header.request;
      served = open_window(peer, body);
    } else if constexpr (std::is_same_v<Body, ExecutorRequest>) {
      id = body.request;
      served = open_executor(peer, body);
    } else if constexpr (std::is_same_v<Body, CreateRequest>) {
      id = body.request;
      served = create(peer, body);
    } else if constexpr (std::is_same_v<Body, LeaveRequest>) {
      id = body.reference.header.request;
      served = membership_.leave(*peer.session.client(), body);
    } else if constexpr (std::is_same_v<Body, DrainedRequest>) {
      id = body.reference.header.request;
      served = membership_.drained(*peer.session.client(), body);
    } else if constexpr (std::is_same_v<Body, wire::Unlinked>) {
      id = body.header.request;
      served = membership_.unlinked(*peer.session.client(), body);
    } else if constexpr (std::is_same_v<Body, wire::Blocked>) {
      id = body.header.request;
      served = blocked(peer, body);
    } else if constexpr (std::is_same_v<Body, wire::Observe>) {
      id = body.header.request;
      served = observe(peer, body);
    } else if constexpr (std::is_same_v<Body, wire::Dump>) {
      id = body.header.request;
      served = dump(peer, body);
    } else if constexpr (std::is_same_v<Body, wire::Revoke>) {
      id = body.header.request;
      served = revoke(peer, body);
    } else if constexpr (std::is_same_v<Body, wire::ReadJournal>) {
      id = body.header.request;
      served = read_journal(peer, body);
    } else {
      id = body.request;
      served = refusal(body.code, body.text);
    }
  };
  std::visit(handle, request);
  if (served) return;
  // It ended while nobody served; another may have its place by now.
  if (!peer.session.greeted() && peer.session.identity().process.ended()) return;
  const std::string_view detail = detail_of(served.error());
  refuse(peer, id, served.error().code, served.error().os_errno,
         detail.empty() ? served.error().what : detail);
  const auto* const rejected = std::get_if<Rejected>(&request);
  if (rejected != nullptr && rejected->ends_connection)
    disconnect(peer, "a packet could not be parsed");
}

Result<void> Broker::check_caller(const Peer& peer, std::uint64_t fingerprint) {
  if (fingerprint != abi::fingerprint())
    return refusal(Errc::layout_mismatch, "the library has layout " + hexadecimal(fingerprint) +
                                              ", the daemon has layout " +
                                              hexadecimal(abi::fingerprint()));
  if (!peer.session.identity().confirmed)
    return refusal(Errc::permission_denied,
                   "the process that connected is not the one that says hello");
  return {};
}

// A daemon that died while it welcomed a process has left a place that nobody uses.
void Broker::end_unwelcomed(const Peer& again) {
  if (detached_count_ == 0) return;
  std::vector<PeerId> unused;
  for (const Peer* const peer : by_client_) {
    if (peer != nullptr && peer->detached &&
        same_process(peer->session.identity().process, again.session.identity().process) &&
        !maps_file(peer->session.identity().pid, regions_.region_file(*peer->session.client())))
      unused.push_back(peer->id);
  }
  for (const PeerId id : unused)
    reap_peer(*peers_.at(id), DeathReason::let_go, "process says hello again");
}

Result<void> Broker::hello(Peer& peer, const wire::Hello& hello) {
  Session& session = peer.session;
  if (auto known = check_caller(peer, hello.fingerprint); !known) return known;
  end_unwelcomed(peer);
  // Room for one more connection there may be for processes that come back.
  const auto is_client_of_user = [&](const auto& entry) {
    const Session& other = entry.second->session;
    return other.greeted() && other.identity().uid == session.identity().uid;
  };
  const auto clients = std::count_if(peers_.begin(), peers_.end(), is_client_of_user);
  if (peer.counts_as_observer ||
      static_cast<std::uint64_t>(clients) >= options_.config.quota.clients)
    return refusal(Errc::quota_exceeded, clients_text());
  if (was_revoked(peer))
    return refusal(Errc::revoked, "the membership of this process was revoked");
  std::string_view name;
  AGNOCAST_CHECK(text_of(hello.process_name, name));
  const auto plan = registry_.plan_client();
  if (!plan) return tl::unexpected(plan.error());
  const ClientIndex client = plan->index;
  if (auto opened = regions_.open_client(client, plan->generation); !opened) return opened;
  if (auto kept = store_.put(DescriptorStore::process(client), session.identity().process.fd());
      !kept) {
    regions_.close_client(client);
    return kept;
  }
  registry_.add_client({session.identity().uid, session.identity().gid,
                        static_cast<std::uint32_t>(session.identity().pid), hello.domain, name},
                       *plan);
  const ClientRecord& record = registry_.client(client);
  session.greet(client);
  by_client_[number(client)] = &peer;
  auto packet = make_body<wire::Welcome>(wire::Opcode::welcome, hello.header.request);
  packet.fingerprint = abi::fingerprint();
  packet.incarnation = registry_.incarnation();
  packet.client = number(client);
  packet.client_generation = record.generation;
  packet.arena_base = options_.arena.base;
  packet.arena_bytes = options_.arena.bytes;
  packet.client_region_bytes = Registry::client_region_bytes;
  reply(peer, packet_of(packet), {regions_.board_reader(), regions_.region_writer(client)});
  if (regions_.unlocked_count() > 0 && !std::exchange(said_unlocked_, true))
    log_.write(LogLevel::info, "memory not locked", {{"why", "limit of locked memory"}});
  log_.write(LogLevel::debug, "client registered",
             {{"client", number(client)},
              {"generation", record.generation},
              {"pid", session.identity().pid},
              {"uid", session.identity().uid},
              {"domain", hello.domain},
              {"name", name}});
  return {};
}

// The connection that the process had before.
Result<Broker::Peer*> Broker::lost_peer(const Peer& peer, const wire::Rejoin& request) {
  using journal::RejoinDecision;
  const ClientIndex client{static_cast<std::uint32_t>(request.client)};
  const bool is_place = number(client) < registry_.client_high();
  Peer* const before = is_place ? by_client_[number(client)] : nullptr;
  journal::RejoinFacts facts;
  facts.same_layout = request.fingerprint == abi::fingerprint();
  facts.confirmed = peer.session.identity().confirmed;
  facts.same_incarnation = request.incarnation == registry_.incarnation();
  facts.same_generation =
      is_place && registry_.client(client).generation == request.client_generation;
  if (is_place && registry_.client(client).state != ClientState::free)
    facts.state = registry_.is_alive(client) && before != nullptr ? journal::rejoin::alive
                                                                  : journal::rejoin::dead;
  facts.same_process = before != nullptr && same_process(before->session.identity().process,
                                                         peer.session.identity().process);
  switch (journal::decide_rejoin(facts)) {
    case RejoinDecision::take_back:
      return before;
    case RejoinDecision::started_anew:
      return refusal(Errc::started_anew, "the daemon does not know this process");
    case RejoinDecision::revoked:
      return refusal(Errc::revoked, "the membership of this process is over");
    case RejoinDecision::layout_mismatch:
    case RejoinDecision::permission_denied:
      break;
  }
  // check_caller() has said the other reasons for these two.
  return refusal(Errc::permission_denied, "that is the place of another process");
}

Result<void> Broker::rejoin(Peer& peer, const wire::Rejoin& request) {
  if (auto known = check_caller(peer, request.fingerprint); !known) return known;
  const auto before = lost_peer(peer, request);
  if (!before) return tl::unexpected(before.error());
  const ClientIndex client{static_cast<std::uint32_t>(request.client)};
  if (std::exchange(peer.counts_as_observer, false)) {
    // It was taken for one more because the daemon had not seen yet that the old one had ended.
    Connections& used = connections_[peer.session.identity().uid];
    --used.observers;
    ++used.clients;
  }
  peer.session.greet(client);
  by_client_[number(client)] = &peer;
  drop((*before)->id);
  registry_.note_rejoined(client);
  auto packet = make_body<wire::Rejoined>(wire::Opcode::rejoined, request.header.request);
  packet.incarnation = registry_.incarnation();
  reply(peer, packet_of(packet));
  membership_.welcome_back(client);
  look_for_collisions_of_publishers(client);  // it may have been asked to move in vain
  log_.write(LogLevel::debug, "client is back",
             {{"client", number(client)}, {"pid", peer.session.identity().pid}});
  return {};
}

Result<void> Broker::open_window(Peer& peer, const wire::WindowRequest& request) {
  const ClientIndex client = *peer.session.client();
  const ClientRecord& record = registry_.client(client);
  if (request.window > record.window_count)
    return refusal(Errc::protocol_violation, "windows are opened one after the other");
  Result<SharedFd> writer = SharedFd();
  if (request.window < record.window_count) {
    ++registry_.counters().requests_answered_again;
    writer = regions_.window_writer(client, request.window);  // asked for again
    if (!writer) return tl::unexpected(writer.error());
  } else {
    if (record.window_count >= options_.config.heap.windows_per_process)
      return refusal(Errc::window_exhausted,
                     "[heap] windows_per_process is " +
                         std::to_string(options_.config.heap.windows_per_process) +
                         ", this process has as many");
    const std::uint64_t bytes = options_.arena.window_bytes;
    if (auto allowed = check_limit(registry_.usage_of(record.uid).heap_bytes, bytes,
                                   options_.config.quota.heap_bytes, "[quota] heap_bytes");
        !allowed)
      return allowed;
    const auto window = choose_window(client);
    if (!window) return tl::unexpected(window.error());
    AGNOCAST_CRASH_POINT(B_window_base);
    writer = regions_.open_window(client, bytes);
    if (!writer) {
      plan_.give_back(window->base);
      return tl::unexpected(writer.error());
    }
    AGNOCAST_CRASH_POINT(B_window_made);
    registry_.open_window(client, *window);
    // Before the answer: the announcement is in a subscriber's socket before the first message lies
    // in the window.
    membership_.announce_window(client);
    log_.write(LogLevel::debug, "window opened",
               {{"client", number(client)},
                {"pid", peer.session.identity().pid},
                {"window", request.window},
                {"first", window->first},
                {"base", hexadecimal(window->base)},
                {"bytes", bytes}});
    look_for_collisions_of_publishers(client);
  }
  auto packet = make_body<wire::WindowOpened>(wire::Opcode::window_opened, request.header.request);
  packet.window = request.window;
  packet.base = record.window[request.window].base;
  packet.bytes = record.window[request.window].bytes;
  packet.first = record.window[request.window].first;
  reply(peer, packet_of(packet), {*writer, regions_.window_readers(client)[request.window]});
  return {};
}

Result<void> Broker::admit_executor(ClientIndex client, const ExecutorRequest& request) {
  namespace found = journal::request;
  const auto& endpoints = registry_.endpoints_of(client);
  const bool in_use = std::any_of(endpoints.begin(), endpoints.end(), [&](const EndpointRef& ref) {
    return ref.kind == Kind::subscription &&
           registry_.subscription(ref.topic, ref.index).executor == request.executor;
  });
  const bool is_open = doorbells_.is_open(client, request.executor);
  if (journal::decide_request(found::open_executor, request.again,
                              !is_open ? found::not_done
                              : in_use ? found::used
                                       : found::done) != journal::RequestDecision::carry_out)
    return refusal(Errc::protocol_violation, "the executor is open");
  if (!is_open)
    return check_limit(registry_.usage_of(registry_.client(client).uid).executors, 1,
                       options_.config.quota.executors, "[quota] executors");
  // The bells were lost with the answer.
  ++registry_.counters().requests_answered_again;
  doorbells_.close(client, request.executor);
  return {};
}

Result<void> Broker::open_executor(Peer& peer, const ExecutorRequest& request) {
  const ClientIndex client = *peer.session.client();
  if (auto admitted = admit_executor(client, request); !admitted) return admitted;
  auto bells = doorbells_.open(client, request.executor);
  if (!bells) return tl::unexpected(bells.error());
  AGNOCAST_CRASH_POINT(B_bell_bound);
  registry_.open_executor(client, static_cast<std::uint32_t>(request.executor));
  const auto packet = make_body<wire::Done>(wire::Opcode::executor_opened, request.request);
  reply(peer, packet_of(packet), std::move(*bells));
  return {};
}

Result<void> Broker::create(Peer& peer, const CreateRequest& request) {
  const ClientIndex client = *peer.session.client();
  const ClientRecord& record = registry_.client(client);
  if (request.again && membership_.answer_again(client, request)) return {};
  if (const auto problem = check_topic_name(request.topic))
    return refusal(Errc::invalid_name,
                   "topic " + printable(request.topic) + ": " + problem->text());
  if (request.qos.depth > options_.config.limits.depth_max)
    return refusal(Errc::depth_refused,
                   "[limits] depth_max is " + std::to_string(options_.config.limits.depth_max) +
                       ", depth " + std::to_string(request.qos.depth) + " is asked for");
  const bool publisher = request.kind == Kind::publisher;
  Subject subject{record.uid, peer.session.identity().groups};
  subject.groups.push_back(record.gid);
  const Decision decision = decide(options_.config.access, subject, record.domain, request.topic,
                                   publisher ? Action::publish : Action::subscribe);
  if (!decision.allowed)
    return refusal(Errc::permission_denied, "user " + std::to_string(record.uid) + " may not " +
                                                (publisher ? "publish on " : "subscribe to ") +
                                                request.topic + " (rule in line " +
                                                std::to_string(decision.line) + ")");
  const Usage usage = registry_.usage_of(record.uid);
  auto allowed =
      publisher
          ? check_limit(usage.publishers, 1, options_.config.quota.publishers, "[quota] publishers")
          : check_limit(usage.subscriptions, 1, options_.config.quota.subscriptions,
                        "[quota] subscriptions");
  if (!allowed) return allowed;
  if (!publisher) {
    allowed = check_limit(usage.held_messages, request.quota, options_.config.quota.held_messages,
                          "[quota] held_messages");
    if (!allowed) return allowed;
  }
  auto created = membership_.create(client, request);
  if (created) {
    log_.write(LogLevel::debug, "endpoint created",
               {{"kind", name_of_kind(request.kind)},
                {"topic", request.topic},
                {"type", request.type},
                {"client", number(client)},
                {"pid", peer.session.identity().pid},
                {"uid", record.uid}});
  }
  return created;
}

// --- observers

Result<void> Broker::observe(Peer& peer, const wire::Observe& request) {
  if (auto known = check_caller(peer, request.fingerprint); !known) return known;
  Connections& used = connections_[peer.session.identity().uid];
  if (!peer.counts_as_observer) {
    if (used.observers >= abi::observer_count_max)
      return refusal(
          Errc::quota_exceeded,
          "this user may have " + std::to_string(abi::observer_count_max) + " observers");
    --used.clients;
    ++used.observers;
    peer.counts_as_observer = true;
  }
  peer.session.observe();
  ++observer_count_;
  auto packet = make_body<wire::Observed>(wire::Opcode::observed, request.header.request);
  packet.fingerprint = abi::fingerprint();
  packet.incarnation = registry_.incarnation();
  packet.client_region_bytes = Registry::client_region_bytes;
  reply(peer, packet_of(packet), {regions_.board_reader()});
  log_.write(LogLevel::debug, "observer",
             {{"pid", peer.session.identity().pid}, {"uid", peer.session.identity().uid}});
  return {};
}

Result<void> Broker::dump(Peer& peer, const wire::Dump& request) {
  answer_at_length(peer, make_dump(registry_, facts(), request.header.request));
  return {};
}

Result<void> Broker::read_journal(Peer& peer, const wire::ReadJournal& request) {
  answer_at_length(peer, make_journal(registry_, request, monotonic_ns()));
  return {};
}

void Broker::answer_at_length(Peer& peer, std::vector<Outgoing> packets) {
  peer.asked_ms = now_ms();
  for (Outgoing& packet : packets) peer.session.push(std::move(packet));
  flush(peer);
}

Result<void> Broker::revoke(Peer& peer, const wire::Revoke& request) {
  const ClientIndex client{static_cast<std::uint32_t>(request.client)};
  if (number(client) >= registry_.client_high() || !registry_.is_alive(client) ||
      registry_.client(client).generation != request.generation)
    return refusal(Errc::endpoint_gone, "there is no such process, or it is no member any more");
  const PeerIdentity& who = peer.session.identity();
  const ClientRecord& record = registry_.client(client);
  if (who.uid != 0 && who.uid != ::geteuid() && who.uid != record.uid)
    return refusal(Errc::permission_denied, "user " + std::to_string(who.uid) +
                                                " may not revoke a process of user " +
                                                std::to_string(record.uid));
  Peer* const revoked = by_client_[number(client)];
  AGNOCAST_CHECK(revoked != nullptr);
  revoke(*revoked,
         "revoked by user " + std::to_string(who.uid) + " (pid " + std::to_string(who.pid) + ")");
  reply(peer, packet_of(make_body<wire::Done>(wire::Opcode::done, request.header.request)));
  return {};
}

DumpFacts Broker::facts() const {
  const std::uint64_t now = monotonic_ns();
  DumpFacts facts;
  wire::DumpDaemon& daemon = facts.daemon;
  daemon.version_major = AGNOCAST_VERSION_MAJOR;
  daemon.version_minor = AGNOCAST_VERSION_MINOR;
  daemon.version_patch = AGNOCAST_VERSION_PATCH;
  daemon.pid = static_cast<std::uint32_t>(::getpid());
  daemon.uid = ::geteuid();
  daemon.incarnation = registry_.incarnation();
  daemon.uptime_ns = now - registry_.header().began_ns;
  daemon.arena_base = options_.arena.base;
  daemon.arena_bytes = options_.arena.bytes;
  daemon.window_bytes = options_.arena.window_bytes;
  daemon.windows_used = plan_.used_count();
  daemon.unlocked_count = regions_.unlocked_count();
  daemon.counters = registry_.counters();
  const Config::Limits& limits = options_.config.limits;
  daemon.limits = {limits.clients,
                   limits.topics,
                   limits.publishers_per_topic,
                   limits.subscriptions_per_topic,
                   limits.slots_per_publisher,
                   limits.depth_max,
                   options_.config.heap.windows_per_process};
  const Config::Quota& quota = options_.config.quota;
  daemon.quota = {quota.clients,   quota.publishers, quota.subscriptions,
                  quota.executors, quota.heap_bytes, quota.held_messages};
  for (const auto& [uid, used] : connections_) {
    facts.users[uid] = {used.clients, used.observers};
    daemon.connections += used.clients;
    daemon.observers += used.observers;
  }
  facts.process_of = [this, now](ClientIndex client) {
    DumpFacts::Process process;
    const Peer* const peer = by_client_[number(client)];
    if (peer != nullptr)
      process.state = peer->detached ? wire::ProcessState::orphaned : wire::ProcessState::connected;
    if (registry_.is_revoked(client)) process.state = wire::ProcessState::revoked;
    process.age_ns = now - registry_.client(client).since_ns;
    process.region = regions_.region_reader(client);
    for (const Obstacles::Claim& claim : obstacles_.of(client)) {
      process.blocked_bytes += claim.bytes;
      if (process.blocked_by.empty()) process.blocked_by = claim.what;
    }
    return process;
  };
  return facts;
}

void Broker::on_ended(ClientIndex client) {
  AGNOCAST_CRASH_POINT(B_place_free);
  regions_.close_client(client);
  const ClientRecord& record = registry_.client(client);
  for (std::uint64_t w = 0; w < record.window_count; ++w)
    AGNOCAST_CHECK(plan_.give_back(record.window[w].base));
  log_.write(LogLevel::debug, "client place free",
             {{"client", number(client)}, {"generation", record.generation}});
}

}  // namespace agnocast::daemon
