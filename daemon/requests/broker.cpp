// SPDX-License-Identifier: Apache-2.0
//
// Broker: connections, and the lives behind them. Requests are in broker_requests.cpp.

#include <daemon/requests/broker.hpp>

#include <base/check.hpp>
#include <base/clock.hpp>
#include <base/names.hpp>
#include <base/step.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <daemon/state/user_log.hpp>

#include <fcntl.h>
#include <malloc.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <iterator>
#include <new>
#include <utility>

namespace agnocast::daemon {

using journal::DeathReason;

namespace {

// How many connections are accepted in a row: whoever connects again and again, refused or not, is never done.
constexpr unsigned connections_per_turn = 8;
// How often a process without a connection is looked at.
constexpr int short_interval_ms = 250;
// How often holds are looked at, what is let go of, and observers.
constexpr int watch_interval_ms = 1'000;

// To a connection that is not taken: it is closed afterwards, but not without a word.
void send_refused(const PacketSocket& socket, Errc code, std::string_view text) noexcept {
  auto packet = make_body<wire::Refused>(wire::Opcode::refused);
  packet.code = static_cast<std::uint32_t>(code);
  packet.text = name_of(text);
  static_cast<void>(socket.send(packet_of(packet)));
}

}  // namespace

Broker::Broker(const BrokerOptions& options, Log& log, Dispatcher& dispatcher, Listener& listener,
               Regions regions, DescriptorStore& store, Errands& errands, Disposal& disposal)
    : options_(options),
      log_(log),
      dispatcher_(dispatcher),
      listener_(listener),
      store_(store),
      errands_(errands),
      disposal_(disposal),
      connections_(dispatcher, disposal),
      output_({options.config.quota.queued_bytes,
               options.config.quota.queued_seconds == unlimited
                   ? std::nullopt
                   : std::optional(options.config.quota.queued_seconds)},
              connections_, dispatcher, log),
      regions_(std::move(regions)),
      registry_(regions_.memory(), {options.config.limits.clients, options.config.limits.topics,
                                    options.config.limits.publishers_per_topic,
                                    options.config.limits.subscriptions_per_topic,
                                    options.config.limits.slots_per_publisher,
                                    options.config.limits.depth_max}),
      access_(options_.config.access, registry_, log),
      plan_(options.arena, options.former_count),
      obstacles_(options.arena),
      doorbells_(listener.bells_directory(), store,
                 [&disposal](std::uint32_t uid, UniqueFd fd) { disposal.close(uid, std::move(fd)); }),
      membership_(registry_, regions_, doorbells_, output_),
      admission_(options_.config, options_.arena, plan_, registry_, membership_, store, access_),
      conflicts_(options_.config.heap, options_.arena, registry_, admission_, plan_, obstacles_, membership_, output_, log),
      reaping_(registry_, regions_, doorbells_, membership_),
      region_look_(connections_, errands, regions_),
      termination_(connections_, dispatcher, registry_, store, obstacles_, membership_, reaping_,
                   region_look_, log),
      scheduler_(connections_, dispatcher, termination_),
      namespaces_(connections_, errands, scheduler_),
      collector_({options_.config, options_.arena, plan_, registry_, regions_, doorbells_, obstacles_,
                  admission_, refusals_, store, connections_, log}),
      answers_(options_.config.quota, registry_, collector_, connections_, output_, termination_),
      observer_requests_(options_.config.access, registry_, regions_, admission_, connections_,
                         output_, termination_, answers_, log),
      hold_watch_(registry_, regions_),
      let_go_watch_(registry_, regions_, membership_, output_),
      refusal_report_(registry_, admission_, refusals_, output_, log),
      server_(admission_, conflicts_, refusal_report_, termination_),
      hello_requests_({options_.arena, registry_, regions_, store, admission_, connections_, output_,
                       scheduler_, region_look_, termination_, server_, log}),
      rejoin_requests_({registry_, doorbells_, membership_, access_, conflicts_, let_go_watch_,
                        connections_, output_, termination_, log}),
      window_requests_(options_.arena, registry_, regions_, plan_, membership_, conflicts_,
                       admission_, output_, log),
      executor_requests_(registry_, doorbells_, admission_, output_),
      endpoint_requests_(options_.config.access, registry_, regions_, membership_, admission_,
                         scheduler_, server_, refusal_report_, log),
      acknowledgement_requests_(membership_, conflicts_),
      spare_(::open("/dev/null", O_RDONLY | O_CLOEXEC)) {
  regions_.use(errands);
  fill_request_table();
  membership_.on_ended = [this](ClientIndex client) { on_ended(client); };
  membership_.on_matched = [this](const EndpointRef& publisher, const EndpointRef& subscription) {
    conflicts_.look_at(publisher, subscription);
  };
}

void Broker::fill_request_table() {
  RequestTable& table = server_.handlers();
  table.add(hello_requests_, &HelloRequests::hello);
  table.add(rejoin_requests_, &RejoinRequests::rejoin);
  table.add(window_requests_, &WindowRequests::open_window);
  table.add(window_requests_, &WindowRequests::bring_window);
  table.add(executor_requests_, &ExecutorRequests::open_executor);
  table.add(endpoint_requests_, &EndpointRequests::create);
  table.add(endpoint_requests_, &EndpointRequests::leave);
  table.add(acknowledgement_requests_, &AcknowledgementRequests::drained);
  table.add(acknowledgement_requests_, &AcknowledgementRequests::unlinked);
  table.add(acknowledgement_requests_, &AcknowledgementRequests::blocked);
  table.add(acknowledgement_requests_, &AcknowledgementRequests::withdrawn);
  table.add(observer_requests_, &ObserverRequests::observe);
  table.add(observer_requests_, &ObserverRequests::dump);
  table.add(observer_requests_, &ObserverRequests::read_journal);
  table.add(observer_requests_, &ObserverRequests::revoke);
  table.add(observer_requests_, &ObserverRequests::set_log_level);
  table.add(observer_requests_, &ObserverRequests::ask_access);
}

Result<void> Broker::found(std::uint64_t incarnation) {
  const Arena& arena = options_.arena;
  registry_.create(incarnation, {arena.base, arena.bytes, arena.window_bytes, monotonic_ns(),
                                 listener_.bells_directory()});
  if (auto kept = regions_.keep(); !kept) return kept;
  return listener_.keep(store_);
}

Broker::~Broker() { dispatcher_.remove(listening_); }

Result<void> Broker::resume() {
  if (auto opened = registry_.open(); !opened) return opened;
  const TableHeader& header = registry_.header();
  options_.arena = {header.arena_base, header.arena_bytes, header.window_bytes};
  plan_ = AddressPlan(options_.arena, options_.former_count);
  return Recovery({options_.arena, plan_, registry_, regions_, doorbells_, membership_, store_,
                   dispatcher_, connections_, scheduler_, namespaces_, termination_, log_})
      .run();
}

Result<void> Broker::start() {
  const auto token =
      dispatcher_.add(listener_.socket().fd(), EPOLLIN, [this](std::uint32_t) { knocks_ = true; });
  if (!token) return tl::unexpected(token.error());
  listening_ = *token;
  return {};
}

// --- connections

void Broker::accept_some() {
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

void Broker::pause_listening() {
  dispatcher_.change(listening_, 0);
  listens_ = false;
}

void Broker::close_connection(PacketSocket socket, std::uint32_t uid) {
  if (refuses_descriptors(socket.fd())) return;
  disposal_.close_connection(uid, socket.release());
}

void Broker::turn_away() {
  ++registry_.counters().connections_refused;
  spare_.reset();
  {
    auto socket = listener_.socket().accept();
    // The last one it had is still being closed. Whoever waits is told again and again.
    if (!socket) pause_listening();
    if (socket && *socket) {
      send_refused(**socket, Errc::limit_reached, "the daemon has no descriptor left");
      const std::uint32_t uid = uid_of((*socket)->fd());
      close_connection(std::move(**socket), uid);
    }
  }
  spare_.reset(::open("/dev/null", O_RDONLY | O_CLOEXEC));
  log_.write_limited(
      "descriptors", LogLevel::error, "connection refused",
      {{"code", word_of(Errc::limit_reached)}, {"why", "no descriptor left; raise LimitNOFILE"}});
}

void Broker::accept(PacketSocket socket) {
  if (!MemoryReserve::refill()) {
    ++registry_.counters().connections_refused;
    send_refused(socket, Errc::limit_reached, no_memory_text);
    const std::uint32_t uid = uid_of(socket.fd());
    close_connection(std::move(socket), uid);
    return;
  }
  auto identity = identify_peer(socket.fd());
  if (!identity) {
    log_.write_limited("identify", LogLevel::warning, "connection refused",
                       {{"code", word_of(identity.error().code)},
                        {"errno", identity.error().os_errno},
                        {"why", identity.error().what}});
    send_refused(socket, identity.error().code, identity.error().what);
    const std::uint32_t uid = uid_of(socket.fd());
    close_connection(std::move(socket), uid);
    return;
  }
  AGNOCAST_CRASH_POINT(B_accepted);
  const std::uint32_t uid = identity->uid;
  if (const std::size_t stuck = disposal_.stuck(uid); stuck > 1)
    log_.write_limited("disposal uid=" + std::to_string(uid), LogLevel::error,
                       "connections cannot be closed",
                       {{"pid", identity->pid},
                        {"uid", uid},
                        {"threads", stuck},
                        {"why", "what this user has sent does not come to its end"}});
  UserConnections& used = connections_.user(uid);
  // Who has all the clients he may have can still look at them: such a connection can only observe.
  // Processes that have lost their connection may come back.
  const bool only_observes = used.clients >= options_.config.quota.clients + used.detached;
  if (only_observes && used.observers >= abi::observer_count_max) {
    ++registry_.counters().connections_refused;
    send_refused(socket, Errc::quota_exceeded, admission_.clients_text());
    log_.write_limited("connections uid=" + std::to_string(uid), LogLevel::warning,
                       "connection refused",
                       {{"pid", identity->pid},
                        {"uid", uid},
                        {"limit", "[quota] clients"},
                        {"value", options_.config.quota.clients},
                        {"used", used.clients},
                        {"asked", 1},
                        {"code", "quota_exceeded"}});
    close_connection(std::move(socket), uid);
    return;
  }
  // A former daemon may have listened without.
  const bool may_carry = !refuses_descriptors(socket.fd());
  if (may_carry) refuse_descriptors(socket.fd());
  const PeerId id = connections_.next_id();
  used.kept->bytes_max = options_.config.quota.queued_bytes;
  auto peer =
      std::make_unique<Peer>(Peer{id, Session(std::move(socket), std::move(*identity), used.kept)});
  peer->session.set_may_carry(may_carry);
  const auto connection = dispatcher_.add(peer->session.socket().fd(), EPOLLIN,
                                          scheduler_.event_handler(id, false));
  const auto process =
      !connection ? connection
                  : dispatcher_.add(peer->session.identity().process.fd(), EPOLLIN,
                                    scheduler_.event_handler(id, true));
  if (!process) {
    if (connection) dispatcher_.remove(*connection);
    send_refused(peer->session.socket(), process.error().code, process.error().what);
    connections_.close(*peer);
    return;
  }
  peer->connection = *connection;
  peer->process = *process;
  peer->counts_as_observer = only_observes;
  namespaces_.find(connections_.add(std::move(peer)));
}

void Broker::serve_waiting() {
  scheduler_.serve([this](PeerId id, const TimeSlice& slice) { return take_turn(id, slice); });
  // Whose connection has just ended may take another one.
  if (std::exchange(knocks_, false)) accept_some();
}

// Who has more to say is found by the dispatcher again, and waits behind the others of its user.
std::optional<unsigned> Broker::take_turn(PeerId id, const TimeSlice& slice) {
  Peer* const found = connections_.find(id);
  if (found == nullptr) return std::nullopt;
  found->waits = false;
  const bool ended = found->ended;
  // Once a whole slice: another process may hold the connection, and never be done.
  const unsigned count = read_packets(id, ended ? TimeSlice() : slice);
  if (Peer* const still = connections_.find(id); ended && still != nullptr)
    termination_.reap(*still, DeathReason::died, "process ended");
  return count;
}

unsigned Broker::read_packets(PeerId id, const TimeSlice& slice) {
  std::array<std::byte, wire::packet_bytes_max> buffer;
  for (unsigned turn = 0; turn < slice.packets_left; ++turn) {
    if (turn > 0 && monotonic_ns() >= slice.until_ns) return turn;
    Peer* const found = connections_.find(id);
    if (found == nullptr || found->session.closed()) return turn;
    Peer& peer = *found;
    if (peer.revoked) {
      termination_.say_farewell(peer);
      return turn;
    }
    if (peer.parked != 0) return turn;
    const bool observes = peer.session.role() == Role::observer;
    if (observes && turn > 0) return turn;  // a dump is work
    // A blocked writer is woken here as well: the handler does not tell the events apart.
    if (peer.wants_writable && turn == 0) {
      output_.flush(peer);
      if (connections_.find(id) == nullptr || peer.session.closed()) return turn;
    }
    if (peer.session.may_carry() && !may_receive(peer, buffer)) return turn;
    auto packet = peer.session.socket().receive(buffer);
    if (!packet) {
      termination_.disconnect(peer, packet.error().what);
      return turn;
    }
    if (packet->kind == Packet::Kind::nothing) return turn;
    if (packet->kind == Packet::Kind::end) {
      termination_.disconnect(peer, "closed by the process");
      return turn;
    }
    if (packet->credentials && !peer.session.identity().confirmed)
      confirm(peer.session.identity(), *packet->credentials);
    if (observes && (peer.session.has_output() || peer.asked)) {
      termination_.disconnect(peer, "an observer asks before it has read");
      return turn;
    }
    AGNOCAST_CRASH_POINT(B_request);
    const Envelope envelope{packet->descriptor_count, packet->truncated, packet->descriptors_lost};
    server_.serve_packet(peer, {buffer.data(), packet->bytes}, envelope, packet->fds());
  }
  return slice.packets_left;
}

// A descriptor that is received is one to close, and the kernel may close some on the way. So a packet that
// brings any is left where it is, and goes with its connection. Only a window is wanted.
bool Broker::may_receive(Peer& peer, std::span<std::byte> buffer) {
  const auto next = peer.session.socket().peek(buffer);
  if (!next) {
    termination_.disconnect(peer, next.error().what);
    return false;
  }
  if (next->kind == Packet::Kind::nothing) {
    // A sender that was let through just before the kernel began to refuse has come to its end by then.
    constexpr std::uint64_t sending_ms = 1'000;
    if (!peer.brings_windows && refuses_descriptors(peer.session.socket().fd()) &&
        monotonic_ms() - peer.refuses_since_ms >= sending_ms)
      peer.session.set_may_carry(false);
    return false;
  }
  if (!next->has_descriptors) return true;
  wire::BringWindow window{};
  if (next->bytes == sizeof window) std::memcpy(static_cast<void*>(&window), buffer.data(), sizeof window);
  if (window.header.opcode == wire::Opcode::bring_window &&
      peer.session.role() == Role::client && peer.brings_windows &&
      disposal_.may_receive(peer.session.identity().uid)) {
    receive_window(peer);
    return false;
  }
  const PeerId id = peer.id;
  server_.serve_packet(peer, buffer.first(next->bytes), {1, next->truncated, true}, {});
  if (Peer* const found = connections_.find(id); found != nullptr && !found->session.closed())
    termination_.disconnect(*found, "descriptors came with a packet");
  return false;
}

// All of it happens elsewhere: for want of a number the kernel closes what comes, and whatever is not a
// window is closed there, too.
void Broker::receive_window(Peer& peer) {
  const std::uint32_t uid = peer.session.identity().uid;
  // Another number of the connection: the loop may close its own meanwhile.
  PacketSocket socket(UniqueFd(::fcntl(peer.session.socket().fd(), F_DUPFD_CLOEXEC, 0)));
  if (!socket) {
    termination_.disconnect(peer, "no descriptor is left to receive a window with");
    return;
  }
  const std::uint64_t ticket = scheduler_.next_ticket();
  scheduler_.park(peer, ticket);
  disposal_.receive(uid, std::move(socket), wire::packet_bytes_max,
                    [this, id = peer.id, ticket, uid, here = std::weak_ptr(here_)](
                        Disposal::Received& received) {
                      if (!here.expired()) serve_window(id, ticket, received);
                      disposal_.close_memory(uid, std::move(received.memory.memory));
                    });
}

void Broker::serve_window(PeerId id, std::uint64_t ticket, Disposal::Received& received) {
  Peer* const peer = scheduler_.unpark(id, ticket);
  if (peer == nullptr) return;
  const Result<Packet>& packet = received.memory.packet;
  if (!packet) {
    termination_.disconnect(*peer, packet.error().what);
  } else if (packet->kind == Packet::Kind::data) {
    AGNOCAST_CRASH_POINT(B_request);
    server_.serve_packet(
        *peer, {received.bytes.data(), packet->bytes},
        {received.memory.descriptor_count, packet->truncated, packet->descriptors_lost},
        std::span(&received.memory.memory, 1));
  }
}

void Broker::tick() {
  reaping_.go_on();
  const std::uint64_t now = monotonic_ms();
  if (now - looked_ms_ >= short_interval_ms) look_around(now);  // however many events there are
  answers_.answer_who_awaits_change();                          // of the events, and of the look
  answers_.go_on();
}

void Broker::look_around(std::uint64_t now) {
  looked_ms_ = now;
  endpoint_requests_.refuse_uncleared(now);
  if (!std::exchange(listens_, true)) {
    if (!spare_) spare_.reset(::open("/dev/null", O_RDONLY | O_CLOEXEC));
    dispatcher_.change(listening_, EPOLLIN);
  }
  output_.go_on_flushing();
  if (connections_.detached_count() > 0) {
    std::vector<Peer*> lost;
    for (const auto& [id, peer] : connections_.all()) {
      if (peer->detached) lost.push_back(peer.get());
    }
    // Those first that have waited longest: there may be no time for all.
    std::sort(lost.begin(), lost.end(),
              [](const Peer* a, const Peer* b) { return a->looked_ns < b->looked_ns; });
    for (Peer* const peer : lost) {
      if (peer->looking || peer->ended) continue;
      peer->looked_ns = monotonic_ns();
      termination_.look_whether_gone(*peer);
    }
  }
  membership_.go_on_telling();
  membership_.announce_renewed();
  announce_what_waits();
  answers_.drop_slow(now);
  output_.end_old(now);
  connections_.give_memory_back();
  answers_.forget_idle_users(now);
  if (now - watched_ms_ >= watch_interval_ms) {
    watched_ms_ = now;
    watch_holds();
    watch_letting_go();
    doorbells_.look();
  }
  log_.flush();
}

void Broker::announce_what_waits() {
  if (!membership_.has_waiting()) return;
  log_.write_limited("announcement", LogLevel::error, "announcement waits",
                     {{"why", "no descriptor left; raise LimitNOFILE"}});
  const bool has_descriptor{UniqueFd(::open("/dev/null", O_RDONLY | O_CLOEXEC))};
  if (has_descriptor) membership_.announce_waiting();
}

int Broker::due_ms() const noexcept {
  if (!scheduler_.nobody_waits() || !reaping_.is_empty()) return 0;
  if (!listens_) return short_interval_ms;
  if (const int due = answers_.due_ms(); due >= 0) return std::min(due, short_interval_ms);
  if (connections_.detached_count() > 0 || output_.flushes_later() || membership_.has_waiting() || membership_.tells() ||
      membership_.has_renewed() || endpoint_requests_.has_uncleared())
    return short_interval_ms;
  return connections_.all().empty() ? 10'000 : watch_interval_ms;
}

void Broker::watch_holds() {
  for (const HoldWatch::Finding& liar : hold_watch_.look()) {
    // The end of another one may have been the end of this place.
    if (!registry_.is_used(liar.subscription)) continue;
    Peer* const peer = connections_.of_client(registry_.owner_of(liar.subscription));
    if (peer == nullptr) continue;
    termination_.revoke(*peer, "its subscription to " +
                      std::string(registry_.topic(liar.subscription.topic).name) + " holds " +
                      std::to_string(liar.held) + " messages of one publisher, its quota is " +
                      std::to_string(liar.quota));
  }
}

void Broker::watch_letting_go() {
  for (const LetGoWatch::Finding& found : let_go_watch_.look()) {
    if (connections_.of_client(found.client) == nullptr) continue;
    // It may have said so, and wait for its turn.
    read_packets(connections_.of_client(found.client)->id, TimeSlice());
    Peer* const peer = connections_.of_client(found.client);
    if (peer == nullptr || !let_go_watch_.is_true(found)) continue;
    const EndpointRef& oldest = found.oldest;
    termination_.revoke(*peer, "it does not let go of " + std::to_string(found.count) +
                      " endpoints that are gone, the oldest a " +
                      (oldest.kind == Kind::publisher ? "publisher" : "subscription") + " of " +
                      printable(registry_.topic(oldest.topic).name));
  }
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
