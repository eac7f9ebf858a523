// SPDX-License-Identifier: Apache-2.0
//
// Broker: requests of clients, and why they are refused. docs/control-plane.md.
//
// A request is a parsed packet: bounded, but true only as far as it was checked here against quotas,
// access rules and the tables. What it changes is journaled before it is answered.

#include <daemon/requests/broker.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/check.hpp>
#include <base/clock.hpp>
#include <base/names.hpp>
#include <base/step.hpp>
#include <daemon/requests/check_caller.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <journal/cases.hpp>

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <memory>
#include <type_traits>
#include <utility>

namespace agnocast::daemon {

using journal::DeathReason;

namespace {

// Places that a hello waits for: a daemon that died twice while it welcomed a process has left two.
constexpr std::size_t unused_count_max = 4;
const char* name_of_kind(Kind kind) noexcept {
  return kind == Kind::publisher ? "publisher" : "subscription";
}

}  // namespace

void Broker::refuse(Peer& peer, const Request& request, std::uint64_t id, Errc code, int os_errno,
                    std::string_view text) {
  auto packet = make_body<wire::Refused>(wire::Opcode::refused, id);
  packet.code = static_cast<std::uint32_t>(code);
  packet.os_errno = static_cast<std::uint32_t>(os_errno);
  packet.text = name_of(text);
  const std::uint32_t uid = peer.session.identity().uid;
  ++registry_.counters().requests_refused;
  std::optional<std::string_view> topic, limit;
  std::optional<std::uint64_t> value, used, asked;
  if (const auto* const create = std::get_if<CreateRequest>(&request)) topic = create->topic;
  const Admission::Exceeded& exceeded = admission_.exceeded();
  if (code == Errc::quota_exceeded && !exceeded.limit.empty()) {
    limit = exceeded.limit;
    value = exceeded.value;
    used = exceeded.used;
    asked = exceeded.asked;
  }
  log_.write_limited("refused uid=" + std::to_string(uid), LogLevel::warning, "request refused",
                     {{"pid", peer.session.identity().pid},
                      {"uid", uid},
                      {"topic", topic},
                      {"limit", limit},
                      {"value", value},
                      {"used", used},
                      {"asked", asked},
                      {"code", word_of(code)},
                      {"errno", os_errno},
                      {"why", text}});
  output_.reply(peer, packet_of(packet));
}

void Broker::remember(const Peer& peer, const Request& request, Errc code, std::string_view why) {
  const PeerIdentity& who = peer.session.identity();
  Refusals::Refusal refusal;
  refusal.code = code;
  refusal.uid = who.uid;
  refusal.pid = static_cast<std::uint32_t>(who.pid);
  refusal.why = why;
  refusal.stamp_ns = monotonic_ns();
  if (const auto client = peer.session.client()) {
    refusal.domain = registry_.client(*client).domain;
    refusal.process_name = registry_.client(*client).name;
  }
  if (const auto* const create = std::get_if<CreateRequest>(&request)) {
    refusal.kind = create->kind;
    refusal.topic = create->topic;
  }
  refusals_.add(std::move(refusal));
}

void Broker::serve(Peer& peer, const Request& request, std::span<UniqueFd> fds) {
  Result<void> served;
  std::uint64_t id = 0;
  admission_.begin_request();
  conflicts_.begin_request();
  if (std::holds_alternative<CreateRequest>(request) ||
      std::holds_alternative<wire::WindowRequest>(request) ||
      std::holds_alternative<ExecutorRequest>(request))
    expect_no_windows(peer);
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
    } else if constexpr (std::is_same_v<Body, wire::BringWindow>) {
      id = body.header.request;
      served = bring_window(peer, body, fds[0]);  // decode() has counted them
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
      served = conflicts_.add_obstacle(peer.session.identity(), *peer.session.client(), body);
    } else if constexpr (std::is_same_v<Body, wire::Withdrawn>) {
      id = body.header.request;
      conflicts_.log_withdrawn(peer.session.identity(), *peer.session.client(), body);
    } else if constexpr (std::is_same_v<Body, wire::Observe>) {
      id = body.header.request;
      served = observer_requests_.observe(peer, body);
    } else if constexpr (std::is_same_v<Body, wire::Dump>) {
      id = body.header.request;
      served = observer_requests_.dump(peer, body);
    } else if constexpr (std::is_same_v<Body, wire::Revoke>) {
      id = body.header.request;
      served = observer_requests_.revoke(peer, body);
    } else if constexpr (std::is_same_v<Body, wire::ReadJournal>) {
      id = body.header.request;
      served = observer_requests_.read_journal(peer, body);
    } else if constexpr (std::is_same_v<Body, wire::SetLogLevel>) {
      id = body.header.request;
      served = observer_requests_.set_log_level(peer, body);
    } else if constexpr (std::is_same_v<Body, wire::AskAccess>) {
      id = body.header.request;
      served = observer_requests_.ask_access(peer, body);
    } else {
      id = body.request;
      served = fail_with(body.code, body.text);
    }
  };
  std::visit(handle, request);
  if (served) return;
  // It ended while nobody served; another may have its place by now.
  if (!peer.session.greeted() && peer.session.identity().process.ended()) return;
  const std::string_view detail = detail_of(served.error());
  const std::string why(detail.empty() ? served.error().what : detail);
  remember(peer, request, served.error().code, why);
  refuse(peer, request, id, served.error().code, served.error().os_errno, why);
  const auto* const rejected = std::get_if<Rejected>(&request);
  if (rejected != nullptr && rejected->ends_connection)
    termination_.disconnect(peer, "a packet could not be parsed");
}

/// What is found out of a process that has been here before.
struct Broker::Before {
  std::size_t open = 0;  // looks that have not ended
  RegionTrace revoked = RegionTrace::none;
  std::vector<PeerId> unused;  // places
  void add(PeerId id, bool is_revoked, RegionTrace trace) {
    if (!is_revoked) {
      if (trace == RegionTrace::none) unused.push_back(id);
    } else if (trace == RegionTrace::some || revoked == RegionTrace::none) {
      revoked = trace;
    }
  }
};

// A daemon that died while it welcomed a process has left a place that nobody uses. And a process that was
// revoked may not come back while it has its region; after exec it is another program.
bool Broker::look_before(Peer& peer, const wire::Hello& hello) {
  if (connections_.detached_count() == 0 || peer.revoked_trace) return false;
  const auto before = std::make_shared<Before>();
  const std::uint64_t ticket = scheduler_.next_ticket();
  for (const auto& [id, other] : connections_.all()) {
    // Of the places that a process leaves behind again and again, each is found by its own look.
    if (!other->detached || (before->open >= unused_count_max && !other->revoked) ||
        other->session.identity().pid != peer.session.identity().pid ||
        !same_process(other->session.identity().process, peer.session.identity().process))
      continue;
    const bool asked = region_look_.begin(
        *other, [this, before, hello, caller = peer.id, ticket, id = id, revoked = other->revoked](
                    RegionTrace trace) {
          before->add(id, revoked, trace);
          if (--before->open == 0) welcome_after(caller, ticket, hello, *before);
        });
    if (asked) {
      ++before->open;
    } else {
      before->add(id, other->revoked, RegionTrace::unknown);
    }
  }
  if (before->open == 0) {
    peer.revoked_trace = before->revoked;
    return false;
  }
  scheduler_.park(peer, ticket);
  return true;
}

void Broker::welcome_after(PeerId id, std::uint64_t ticket, const wire::Hello& hello,
                           const Before& before) {
  for (const PeerId unused : before.unused) {
    Peer* const found = connections_.find(unused);
    if (found != nullptr && found->detached && !found->revoked)
      termination_.reap(*found, DeathReason::let_go, "process says hello again");
  }
  Peer* const peer = scheduler_.unpark(id, ticket);
  if (peer == nullptr) return;
  peer->revoked_trace = before.revoked;
  serve_packet(*peer, std::as_bytes(std::span(&hello, 1)), {}, {});
}

Result<void> Broker::hello(Peer& peer, const wire::Hello& hello) {
  Session& session = peer.session;
  if (auto known = check_caller(peer.session.identity(), hello.fingerprint); !known) return known;
  if (look_before(peer, hello)) return {};
  if (auto admitted = admission_.admit_client(session.identity().uid, peer.counts_as_observer);
      !admitted)
    return admitted;
  switch (std::exchange(peer.revoked_trace, std::nullopt).value_or(RegionTrace::none)) {
    case RegionTrace::none:
      break;
    case RegionTrace::some:
      return fail_with(Errc::revoked, "the membership of this process was revoked");
    case RegionTrace::unknown:
      // It may have become another program since. Whoever loses its connection says hello again.
      termination_.disconnect(peer, "no time to look whether the process was revoked");
      return {};
  }
  std::string_view name;
  AGNOCAST_CHECK(text_of(hello.process_name, name));
  const auto plan = registry_.plan_client();
  if (!plan) return tl::unexpected(plan.error());
  const ClientIndex client = plan->index;
  MemoryReserve::no_return();
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
  expect_windows(peer);
  session.greet(client);
  connections_.set_client(client, &peer);
  auto packet = make_body<wire::Welcome>(wire::Opcode::welcome, hello.header.request);
  packet.fingerprint = abi::fingerprint();
  packet.incarnation = registry_.incarnation();
  packet.client = number(client);
  packet.client_generation = record.generation;
  packet.arena_base = options_.arena.base;
  packet.arena_bytes = options_.arena.bytes;
  packet.client_region_bytes = Registry::client_region_bytes;
  output_.reply(peer, packet_of(packet), {regions_.board_reader(), regions_.region_writer(client)});
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
Result<Peer*> Broker::lost_peer(const Peer& peer, const wire::Rejoin& request) {
  using journal::RejoinDecision;
  const ClientIndex client{static_cast<std::uint32_t>(request.client)};
  const bool is_place = number(client) < registry_.client_high();
  Peer* const before = is_place ? connections_.of_client(client) : nullptr;
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
      return fail_with(Errc::started_anew, "the daemon does not know this process");
    case RejoinDecision::revoked:
      return fail_with(Errc::revoked, "the membership of this process is over");
    case RejoinDecision::layout_mismatch:
    case RejoinDecision::permission_denied:
      break;
  }
  // check_caller() has said the other reasons for these two.
  return fail_with(Errc::permission_denied, "that is the place of another process");
}

Result<void> Broker::rejoin(Peer& peer, const wire::Rejoin& request) {
  if (auto known = check_caller(peer.session.identity(), request.fingerprint); !known) return known;
  const auto before = lost_peer(peer, request);
  if (!before) return tl::unexpected(before.error());
  const ClientIndex client{static_cast<std::uint32_t>(request.client)};
  peer.returns = (*before)->returns;
  if (!peer.returns.take(monotonic_ms()))
    return fail_with(Errc::limit_reached, "this process comes back too often; later it may");
  // The rules may be others than those by which it was let in.
  if (const std::string why = access_.forbidden_endpoint(client, peer.session.identity());
      !why.empty()) {
    termination_.revoke(**before, why);
    return fail_with(Errc::revoked, why);
  }
  access_.warn_of_other_readers(client);
  MemoryReserve::no_return();
  // It may have been taken for one more because the daemon had not seen yet that the old one had ended.
  connections_.count_as_client(peer);
  peer.session.greet(client);
  connections_.set_client(client, &peer);
  connections_.remove((*before)->id);
  if (registry_.endpoints_of(client).empty() && registry_.client(client).executors == 0)
    expect_windows(peer);
  registry_.note_rejoined(client);
  auto packet = make_body<wire::Rejoined>(wire::Opcode::rejoined, request.header.request);
  packet.incarnation = registry_.incarnation();
  output_.reply(peer, packet_of(packet));
  let_go_watch_.told_again(client);
  renew_bells(peer);
  membership_.welcome_back(client);
  conflicts_.look_at_publishers_of(client);  // it may have been asked to move in vain
  log_.write(LogLevel::debug, "client is back",
             {{"client", number(client)}, {"pid", peer.session.identity().pid}});
  return {};
}

// Its sleepers would be deaf to publishers of other users for as long as it lives.
void Broker::renew_bells(Peer& peer) {
  const ClientIndex client = *peer.session.client();
  const std::uint64_t executors = registry_.client(client).executors;
  for (std::uint64_t executor = 0; executor < abi::executor_count_max; ++executor) {
    if ((executors >> executor & 1) == 0) continue;
    auto bells = doorbells_.renew(client, executor, registry_.client(client).uid);
    if (!bells || bells->empty()) continue;
    AGNOCAST_CRASH_POINT(B_bell_bound);
    auto packet = make_body<wire::BellsRenewed>(wire::Opcode::bells_renewed);
    packet.executor = executor;
    output_.reply(peer, packet_of(packet), std::move(*bells));
    membership_.renewed(client, executor);
  }
}

// A process brings what it has from a former incarnation before it asks this one for anything. Until then the
// kernel lets descriptors through to the daemon.
void Broker::expect_windows(Peer& peer) {
  peer.brings_windows = true;
  peer.session.set_may_carry(true);
  accept_descriptors(peer.session.socket().fd());
}

void Broker::expect_no_windows(Peer& peer) {
  if (!std::exchange(peer.brings_windows, false)) return;
  refuse_descriptors(peer.session.socket().fd());
  peer.refuses_since_ms = monotonic_ms();
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
    serve_packet(
        *peer, {received.bytes.data(), packet->bytes},
        {received.memory.descriptor_count, packet->truncated, packet->descriptors_lost},
        std::span(&received.memory.memory, 1));
  }
}

// What lies in a window outlives the daemon that gave it: its owner, which knows nobody here yet, keeps
// it where it is, and its readers find the same memory at the same place.
Result<void> Broker::bring_window(Peer& peer, const wire::BringWindow& request,
                                  const UniqueFd& window) {
  const ClientIndex client = *peer.session.client();
  const ClientRecord& record = registry_.client(client);
  const auto done = [&] {
    const auto packet = make_body<wire::Done>(wire::Opcode::done, request.header.request);
    output_.reply(peer, packet_of(packet));
    return Result<void>();
  };
  namespace brought = journal::brought;
  journal::BroughtFacts facts;
  facts.number = request.window < record.window_count    ? brought::known
                 : request.window == record.window_count ? brought::next
                                                         : brought::later;
  Result<void> allowed, ours;
  if (facts.number == brought::known) {
    facts.same_base = record.window[request.window].base == request.base;
  } else if (facts.number == brought::next) {
    facts.possible_group =
        request.first == request.window ||
        (request.window != 0 && request.first == record.window[request.window - 1].first);
    allowed = admission_.admit_brought_window(record, request.bytes);
    // The later failure is the one whose text is kept, and the one that is said.
    ours = Regions::check_window(window.get(), request.base, request.bytes, record.uid);
    facts.room = allowed.has_value();
    facts.ours = ours.has_value();
  }
  facts.free = true;
  MemoryReserve::no_return();
  auto decision = journal::decide_brought(facts);
  if (decision == journal::BroughtDecision::take) {
    facts.free = request.bytes == options_.arena.window_bytes && plan_.adopt(request.base);
    decision = journal::decide_brought(facts);
  }
  switch (decision) {
    case journal::BroughtDecision::take:
      break;
    case journal::BroughtDecision::answer_as_before:
      ++registry_.counters().requests_answered_again;
      return done();
    case journal::BroughtDecision::protocol_violation:
      return fail_with(Errc::protocol_violation,
                     facts.number == brought::known   ? "another window has this number"
                     : facts.number == brought::later ? "windows are brought one after the other"
                                                      : "a window that cannot be of this group");
    case journal::BroughtDecision::permission_denied:
      return ours;
    case journal::BroughtDecision::over_limit:
      return allowed;
    case journal::BroughtDecision::arena_occupied:
      return fail_with(Errc::arena_occupied,
                     "the window at " + hexadecimal(request.base) +
                         " is another process's, or outside [heap] arena_base and arena_bytes");
  }
  AGNOCAST_CRASH_POINT(B_window_base);
  if (auto kept = regions_.bring_window(client, window); !kept) {
    plan_.give_back(request.base);
    return kept;
  }
  AGNOCAST_CRASH_POINT(B_window_made);
  registry_.open_window(client, {request.base, request.bytes, request.first});
  membership_.announce_window(client);
  log_.write(LogLevel::debug, "window brought",
             {{"client", number(client)},
              {"pid", peer.session.identity().pid},
              {"window", request.window},
              {"base", hexadecimal(request.base)}});
  conflicts_.look_at_publishers_of(client);
  return done();
}

Result<void> Broker::open_window(Peer& peer, const wire::WindowRequest& request) {
  const ClientIndex client = *peer.session.client();
  const ClientRecord& record = registry_.client(client);
  if (request.window > record.window_count)
    return fail_with(Errc::protocol_violation, "windows are opened one after the other");
  Result<SharedFd> writer = SharedFd();
  if (request.window < record.window_count) {
    ++registry_.counters().requests_answered_again;
    writer = regions_.window_writer(client, request.window);  // asked for again
    if (!writer) return tl::unexpected(writer.error());
  } else {
    if (auto admitted = admission_.admit_window(record); !admitted) return admitted;
    MemoryReserve::no_return();
    const auto window = conflicts_.choose_window(client);
    if (!window) return tl::unexpected(window.error());
    AGNOCAST_CRASH_POINT(B_window_base);
    writer = regions_.open_window(client, window->base, record.uid);
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
                {"bytes", options_.arena.window_bytes}});
    conflicts_.look_at_publishers_of(client);
  }
  auto packet = make_body<wire::WindowOpened>(wire::Opcode::window_opened, request.header.request);
  packet.window = request.window;
  packet.base = record.window[request.window].base;
  packet.bytes = record.window[request.window].bytes;
  packet.first = record.window[request.window].first;
  output_.reply(peer, packet_of(packet), {*writer, regions_.window_readers(client)[request.window]});
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
    return fail_with(Errc::protocol_violation, "the executor is open");
  if (!is_open) {
    return admission_.admit_executor(registry_.client(client).uid);
  }
  ++registry_.counters().requests_answered_again;  // the bells were lost with the answer
  return {};
}

Result<void> Broker::open_executor(Peer& peer, const ExecutorRequest& request) {
  const ClientIndex client = *peer.session.client();
  if (auto admitted = admit_executor(client, request); !admitted) return admitted;
  MemoryReserve::no_return();
  auto bells = doorbells_.open(client, request.executor, registry_.client(client).uid);
  if (!bells) return tl::unexpected(bells.error());
  AGNOCAST_CRASH_POINT(B_bell_bound);
  registry_.open_executor(client, static_cast<std::uint32_t>(request.executor));
  const auto packet = make_body<wire::Done>(wire::Opcode::executor_opened, request.request);
  output_.reply(peer, packet_of(packet), std::move(*bells));
  return {};
}

Result<void> Broker::create(Peer& peer, const CreateRequest& request) {
  const ClientIndex client = *peer.session.client();
  const ClientRecord& record = registry_.client(client);
  if (request.again && membership_.answer_again(client, request)) return {};
  if (const auto problem = check_topic_name(request.topic))
    return fail_with(Errc::invalid_name,
                   "topic " + printable(request.topic) + ": " + problem->text());
  if (auto admitted = admission_.admit_endpoint(peer.session.identity(), client, request); !admitted)
    return admitted;
  const auto waits = clear_before(peer, request);
  if (!waits) return tl::unexpected(waits.error());
  if (*waits) return {};
  // Before anybody is told of the publisher, and with it of the heap.
  const bool is_first = request.kind == Kind::publisher && record.readers == 0;
  if (is_first)
    registry_.set_readers(client,
                          readers_of(options_.config.access, record.domain, request.topic));
  auto created = membership_.create(client, request);
  if (!created && is_first) registry_.set_readers(client, 0);
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

}  // namespace agnocast::daemon
