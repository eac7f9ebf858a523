// SPDX-License-Identifier: Apache-2.0
//
// Fake broker: see the header.

#include <tests/fuzz/protocol/fake_broker.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/check.hpp>
#include <daemon/death/reaper.hpp>
#include <daemon/observers/dump.hpp>
#include <daemon/observers/flight_recorder.hpp>
#include <daemon/requests/rejoin_facts.hpp>

#include <tests/support/machine/temporary_directory.hpp>

#include <string>
#include <utility>

namespace agnocast::daemon::fuzz {

namespace {

// Small tables fill up soon.
constexpr Capacity capacity{8, 4, 6, 8, abi::slot_count_max};
constexpr Arena arena{arena_base, window_count* window_bytes, window_bytes};

/// For the doorbells of wait sets, of all inputs.
const std::string& doorbells_directory() {
  static const test::TemporaryDirectory directory;
  return directory.path();
}

}  // namespace

FakeBroker::FakeBroker()
    : regions_(std::move(Regions::create(store_).value())),
      registry_(regions_.memory(), capacity),
      plan_(arena),
      obstacles_(arena),
      doorbells_(doorbells_directory(), store_),
      endpoint_manager_(registry_, regions_, doorbells_, *this) {
  registry_.create(incarnation);
  endpoint_manager_.on_client_freed = [this](ClientIndex client) {
    regions_.close_client(client);
    const ClientRecord& record = registry_.client(client);
    for (std::uint64_t w = 0; w < record.window_count; ++w)
      AGNOCAST_CHECK(plan_.give_back(record.window[w].base));
  };
}

// --- the client channel

Process* FakeBroker::process_of(ClientIndex client) {
  for (Process& process : processes_) {
    if (process.client == client) return &process;
  }
  return nullptr;
}

Session* FakeBroker::session_of(ClientIndex client) {
  Process* const process = process_of(client);
  return process == nullptr ? nullptr : process->session.get();
}

void FakeBroker::send(ClientIndex client, Outgoing packet) {
  Process* const to = process_of(client);
  if (to == nullptr || !to->session) return;
  if (packet.complete) packet.complete(packet);
  const std::uint64_t number = to->session->push(packet.bytes, packet.fds);
  to->session->drop_output();
  oracle_.hear(*to, number, packet);
}

// --- a client's packets

void FakeBroker::serve(Process& from, std::span<const std::byte> packet, const Envelope& envelope,
                       const BroughtWindow* brought) {
  if (!from.session) {
    from.session = std::make_unique<Session>(PacketSocket(), PeerIdentity{});
    from.uid = static_cast<std::uint32_t>(&from - processes_.data()) % 2;
  }
  oracle_.expect_answer();
  const Request request = decode(packet, envelope, from.session->role());
  if (const auto* const hello = std::get_if<wire::Hello>(&request)) {
    if (!from.client) greet(from, *hello);
  } else if (const auto* const again = std::get_if<wire::Rejoin>(&request)) {
    rejoin(from, *again);
  } else if (const auto* const window = std::get_if<wire::WindowRequest>(&request)) {
    open_window(from, *window);
  } else if (const auto* const former = std::get_if<wire::BringWindow>(&request)) {
    // A packet that claims a descriptor has one; decode() must refuse all others.
    AGNOCAST_CHECK(brought != nullptr);
    bring_window(from, *former, *brought);
  } else if (const auto* const blocked = std::get_if<wire::Blocked>(&request)) {
    block(from, *blocked);
  } else if (const auto* const executor = std::get_if<WaitSetRequest>(&request)) {
    open_wait_set(from, *executor);
  } else if (const auto* const endpoint = std::get_if<CreateRequest>(&request)) {
    create(from, *endpoint);
  } else if (const auto* const leave = std::get_if<LeaveRequest>(&request)) {
    oracle_.leave_served(from, *leave, endpoint_manager_.leave(*from.client, *leave).has_value());
  } else if (const auto* const drained = std::get_if<DrainedRequest>(&request)) {
    oracle_.drained_served(from, *drained,
                           endpoint_manager_.drained(*from.client, *drained).has_value());
  } else if (const auto* const unlinked = std::get_if<wire::Unlinked>(&request)) {
    if (endpoint_manager_.unlinked(*from.client, *unlinked)) oracle_.unlinked(from, *unlinked);
  }
  // A client cannot send an observer's requests: decode() has refused them.
  AGNOCAST_CHECK(from.session->role() != Role::observer);
  if (from.client && !from.session->greeted()) from.session.reset();  // refused
}

void FakeBroker::greet(Process& from, const wire::Hello& hello) {
  if (hello.fingerprint != abi::fingerprint()) return;
  std::string_view name;
  AGNOCAST_CHECK(text_of(hello.process_name, name));
  const auto client = registry_.add_client({from.uid, from.uid, 1, hello.domain, name});
  if (!client) return;
  const std::uint64_t generation = registry_.client(*client).generation;
  AGNOCAST_CHECK(regions_.open_client(*client, generation).has_value());
  from.session->greet(*client);
  oracle_.greeted(from, *client, generation);
}

journal::RejoinDecision FakeBroker::decide(const Process& from, const wire::Rejoin& request) {
  const Process* const before = process_of(ClientIndex{static_cast<std::uint32_t>(request.client)});
  const bool has_owner = before != nullptr && !before->revoked;
  return journal::decide_rejoin(
      rejoin_facts(request, registry_, {true, has_owner, before == &from}));
}

// docs/control-plane.md, coming back.
void FakeBroker::rejoin(Process& from, const wire::Rejoin& request) {
  const auto decision = decide(from, request);
  oracle_.check_rejoin(from, request, decision);
  if (decision != journal::RejoinDecision::take_back) return;
  from.session->greet(*from.client);
  registry_.note_rejoined(*from.client);
  const auto packet = make_body<wire::Rejoined>(Opcode::rejoined, request.header.request);
  send(*from.client, packet_of(packet), {});
  oracle_.begin_welcome_back(from);
  endpoint_manager_.welcome_back(*from.client);
  oracle_.end_welcome_back(from);
}

void FakeBroker::open_window(Process& from, const wire::WindowRequest& request) {
  if (request.window != registry_.client(*from.client).window_count ||
      request.window >= abi::window_count_max)
    return;
  const auto choice = plan_.take(obstacles_.against(*from.client));
  if (!choice) return;
  oracle_.check_not_blocked(from, window_at(choice->base));
  AGNOCAST_CHECK(regions_.open_window(*from.client, choice->base, from.uid).has_value());
  begin_window(from, {choice->base, window_bytes, 0});
}

// docs/control-plane.md, loss of the store.
void FakeBroker::bring_window(Process& from, const wire::BringWindow& request,
                              const BroughtWindow& brought) {
  const ClientRecord& record = registry_.client(*from.client);
  if (request.window != record.window_count) return;
  if (request.first != request.window &&
      (request.window == 0 || request.first != record.window[request.window - 1].first))
    return;
  const bool is_its_own =
      Regions::check_window(brought.fd->get(), request.base, request.bytes, from.uid).has_value();
  // Its file is empty, as no process uses it: the plan decides by the claimed length.
  AGNOCAST_CHECK(is_its_own == (request.base == brought.base && from.uid == brought.uid));
  if (!is_its_own || request.bytes != window_bytes || !plan_.adopt(request.base)) return;
  AGNOCAST_CHECK(regions_.bring_window(*from.client, *brought.fd).has_value());
  begin_window(from, {request.base, window_bytes, request.first});
}

void FakeBroker::begin_window(Process& owner, const WindowRecord& window) {
  oracle_.window_given(owner, window_at(window.base));
  registry_.open_window(*owner.client, window);
  endpoint_manager_.announce_window(*owner.client);
}

void FakeBroker::block(Process& from, const wire::Blocked& request) {
  std::string_view what;
  AGNOCAST_CHECK(text_of(request.what, what));
  if (obstacles_.add(*from.client, from.uid, request.base, request.bytes, printable(what)))
    oracle_.blocked(from, {request.base, request.base + request.bytes});
}

void FakeBroker::open_wait_set(const Process& from, const WaitSetRequest& request) {
  if (!doorbells_.is_open(*from.client, request.wait_set) &&
      doorbells_.open(*from.client, request.wait_set, 0))
    registry_.open_wait_set(*from.client, static_cast<std::uint32_t>(request.wait_set));
}

void FakeBroker::create(Process& from, const CreateRequest& request) {
  if (const Endpoint* const before = oracle_.created_before(from, request)) {
    if (!request.again || before->left) return;  // a client uses no id twice, nor a lower one
    AGNOCAST_CHECK(endpoint_manager_.answer_again(*from.client, request));
    return oracle_.check_answered_again(*before);
  }
  if (from.created.contains(request.request)) return;
  if (request.again) AGNOCAST_CHECK(!endpoint_manager_.answer_again(*from.client, request));
  oracle_.create_served(from, request, endpoint_manager_.create(*from.client, request).has_value());
}

// --- an observer's packets

void FakeBroker::serve_observer(std::span<const std::byte> packet) {
  const Request request = decode(packet, {}, observer_.role());
  if (const auto* const observe = std::get_if<wire::Observe>(&request)) {
    if (observe->fingerprint == abi::fingerprint()) observer_.observe();
  } else if (const auto* const dump = std::get_if<wire::Dump>(&request)) {
    DumpFacts facts;
    facts.process_of = [&](ClientIndex client) {
      DumpFacts::Process process;
      process.region = regions_.region_reader(client);
      return process;
    };
    Oracle::check_whole(make_dump(registry_, facts, *dump), Opcode::dump_end);
  } else if (const auto* const read = std::get_if<wire::ReadJournal>(&request)) {
    Oracle::check_whole(make_journal(registry_, *read, 1), Opcode::journal_end);
  } else if (const auto* const revocation = std::get_if<wire::Revoke>(&request)) {
    revoke(*revocation);
  }
}

void FakeBroker::revoke(const wire::Revoke& request) {
  const ClientIndex client{static_cast<std::uint32_t>(request.client)};
  if (number(client) >= registry_.client_high() || !registry_.is_alive(client) ||
      registry_.client(client).generation != request.generation)
    return;
  Process* const process = process_of(client);
  AGNOCAST_CHECK(process != nullptr && process->generation == request.generation);
  process->session.reset();
  oracle_.revoked(*process);
  obstacles_.forget(client);
  Reaping reaping(client, journal::DeathReason::revoked, registry_, regions_, doorbells_,
                  endpoint_manager_);
  while (!reaping.go_on(UINT64_MAX)) {
  }
  AGNOCAST_CHECK(registry_.is_revoked(client));
}

// --- the end of a process

void FakeBroker::die(Process& process) {
  const Process dead = std::exchange(process, Process{});
  if (!dead.client) return;
  const ClientIndex client = *dead.client;
  if (dead.revoked) {
    registry_.client_died(client, journal::DeathReason::died);
    endpoint_manager_.run(endpoint_manager_.endings().free_unused_client(client));
    return;
  }
  obstacles_.forget(client);
  Reaping reaping(client, journal::DeathReason::died, registry_, regions_, doorbells_,
                  endpoint_manager_);
  while (!reaping.go_on(UINT64_MAX)) {
  }
}

}  // namespace agnocast::daemon::fuzz
