// SPDX-License-Identifier: Apache-2.0
//
// Scenario: see the header.

#include <tests/fuzz/protocol/scenario.hpp>

#include <agnocast/abi/fingerprint.hpp>

#include <fcntl.h>

#include <algorithm>
#include <cstring>
#include <map>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::daemon::fuzz {

namespace {

/// Returns a window that an earlier daemon made for a user. All inputs share it.
const UniqueFd& former_window(std::uint64_t base, std::uint32_t uid) {
  static DescriptorStore store;
  static Regions regions = std::move(Regions::create(store).value());
  static std::map<std::pair<std::uint64_t, std::uint32_t>, UniqueFd> windows;
  UniqueFd& window = windows[{base, uid}];
  if (!window) {
    const auto made = regions.open_window(ClientIndex{0}, base, uid);
    window = UniqueFd(::fcntl((*made)->get(), F_DUPFD_CLOEXEC, 0));
  }
  return window;
}

}  // namespace

void Scenario::step() {
  Process& process = any_process();
  switch (up_to(31)) {
    case 0:
      return daemon_.die(process);
    case 1:
      return store(process);
    case 2:
      // The connection ends, the process does not.
      if (process.client) daemon_.disconnect(process);
      return;
    case 3:
    case 4:
      return watch();
    default:
      return say(process);
  }
}

/// Stores any words into the process's own endpoints: recovery reads them at its death.
void Scenario::store(const Process& process) {
  if (!process.client || process.own.empty()) return;
  const Endpoint& where = one_of(process.own);
  for (int i = input_.ConsumeIntegralInRange(1, 4); i > 0; --i) {
    const std::uint64_t word = up_to(31);
    SharedMemory::word(process.region.base(), where.extent.from + word * 8)
        .store(input_.ConsumeBool() ? any_word() : input_.ConsumeIntegral<std::uint8_t>());
  }
}

// --- a client's packets

void Scenario::say(Process& process) {
  if (!process.client && !rarely()) return say_first(process);
  if (process.client && !process.connection && !rarely()) return say_rejoin(process, process);
  switch (up_to(18)) {
    case 0:
      return say_anything(process);
    case 1:
      return say_right_in_length(process);
    case 2:
      return say_hello(process);
    case 3:
      return say_open_window(process);
    case 4:
      return say_open_executor(process);
    case 5:
    case 6:
    case 7:
      return say_create(process);
    case 8:
    case 9:
    case 10:
    case 11:
      return say_leave_or_drained(process);
    case 12:
    case 13:
    case 14:
      return say_unlinked_endpoint(process);
    case 15:
      return say_unlinked_region(process);
    case 16:
      return say_blocked(process);
    case 17:
      return say_bring_window(process);
    default:
      return say_rejoin(process, any_process());
  }
}

void Scenario::say_anything(Process& process) {
  const auto bytes = input_.ConsumeBytes<std::uint8_t>(up_to(wire::packet_bytes_max));
  const std::size_t descriptor_count = up_to(2);
  const BroughtWindow brought = draw_former_window(process);
  daemon_.serve(process, std::as_bytes(std::span(bytes)), descriptor_count, brought);
}

void Scenario::say_right_in_length(Process& process) {
  constexpr std::pair<Opcode, std::size_t> packets[] = {
      {Opcode::open_window, sizeof(wire::WindowRequest)},
      {Opcode::open_wait_set, sizeof(wire::WaitSetRequest)},
      {Opcode::create_publisher, sizeof(wire::CreateEndpoint)},
      {Opcode::create_subscription, sizeof(wire::CreateEndpoint)},
      {Opcode::leave, sizeof(wire::Reference)},
      {Opcode::drained, sizeof(wire::Reference)},
      {Opcode::unlinked, sizeof(wire::Unlinked)},
      {Opcode::hello, sizeof(wire::Hello)},
      {Opcode::rejoin, sizeof(wire::Rejoin)},
      {Opcode::blocked, sizeof(wire::Blocked)},
      {Opcode::withdrawn, sizeof(wire::Withdrawn)},
      {Opcode::callback_group, sizeof(wire::CallbackGroup)},
      {Opcode::callback_thread, sizeof(wire::CallbackThread)},
      {Opcode::watch_graph, sizeof(wire::WatchGraph)},
      {Opcode::observe, sizeof(wire::Observe)},
      {Opcode::dump, sizeof(wire::Dump)},
      {Opcode::revoke, sizeof(wire::Revoke)},
      {Opcode::read_journal, sizeof(wire::ReadJournal)},
      {Opcode::set_log_level, sizeof(wire::SetLogLevel)},
      {Opcode::ask_access, sizeof(wire::AskAccess)}};
  const auto [opcode, size] = one_of(packets);
  std::vector<std::byte> packet(size);
  const auto body = input_.ConsumeBytes<std::uint8_t>(size - sizeof(wire::Header));
  std::transform(body.begin(), body.end(), packet.begin() + sizeof(wire::Header),
                 [](std::uint8_t byte) { return std::byte{byte}; });
  const wire::Header header{opcode, static_cast<std::uint32_t>(size), ++last_request_};
  std::memcpy(packet.data(), &header, sizeof header);
  daemon_.serve(process, packet);
}

/// Sends what a process must send before other requests get far.
void Scenario::say_first(Process& process) {
  wire::Hello body{};
  body.fingerprint = abi::fingerprint();
  body.domain = rarely() ? 1 : 0;
  ask(process, Opcode::hello, body);
  ask(process, Opcode::open_wait_set, wire::WaitSetRequest{});
}

void Scenario::say_hello(Process& process) {
  wire::Hello body{};
  body.fingerprint = abi::fingerprint();
  ask(process, Opcode::hello, body);
}

void Scenario::say_rejoin(Process& process, const Process& as) {
  wire::Rejoin body{};
  body.fingerprint = abi::fingerprint() + (rarely() ? 1 : 0);
  body.incarnation = incarnation + (rarely() ? 1 : 0);
  body.client = as.client ? number(*as.client) : up_to(8);
  body.client_generation = as.generation + (rarely() ? 1 : 0);
  ask(process, Opcode::rejoin, body);
}

void Scenario::say_open_window(Process& process) {
  wire::WindowRequest body{};
  body.window = up_to(3);
  ask(process, Opcode::open_window, body);
}

BroughtWindow Scenario::draw_former_window(const Process& process) {
  const std::uint64_t base = arena_base + up_to(window_count - 1) * window_bytes;
  const std::uint32_t uid = rarely() ? process.uid ^ 1 : process.uid;
  return {&former_window(base, uid), base, uid};
}

void Scenario::say_bring_window(Process& process) {
  const BroughtWindow brought = draw_former_window(process);
  auto body = make_body<wire::BringWindow>(Opcode::bring_window, ++last_request_);
  body.window = process.heap.size() + (rarely() ? 1 : 0);
  body.base = brought.base + (rarely() ? window_bytes : 0);
  body.bytes = window_bytes << (rarely() ? 1 : 0);
  body.first = rarely() ? 0 : body.window;
  const std::size_t descriptor_count = rarely() ? 0 : 1;
  daemon_.serve(process, packet_of(body), descriptor_count, brought);
}

void Scenario::say_blocked(Process& process) {
  wire::Blocked body{};
  body.base = arena_base + up_to(window_count) * window_bytes;
  if (rarely()) body.base = any_word();
  body.bytes = rarely() ? any_word() : up_to(2 * window_bytes);
  ask(process, Opcode::blocked, body);
}

void Scenario::say_open_executor(Process& process) {
  wire::WaitSetRequest body{};
  body.wait_set = up_to(1);
  ask(process, Opcode::open_wait_set, body);
}

void Scenario::say_create(Process& process) {
  wire::CreateEndpoint body{};
  abi::Qos qos{input_.ConsumeIntegralInRange(1u, abi::depth_max), rarely(), !rarely(), rarely(),
               false};
  if (rarely()) qos.deadline_ns = 1 + up_to(1);
  if (rarely()) qos.lease_ns = 1 + up_to(1);
  if (rarely()) qos.lifespan_ns = any_word();
  qos.manual_liveliness = rarely();
  body.layout_hash = rarely() ? 2 : 1;
  if (rarely()) body.domain = up_to(2);
  body.wait_set = rarely() ? 1 : 0;
  body.quota = input_.ConsumeIntegralInRange<std::uint64_t>(1, 800);
  // One draw for both. Three of eight subscriptions ignore the publishers of their own process; a
  // publisher with that bit is refused.
  const std::uint64_t kind = up_to(15);
  const bool publisher = kind % 2 == 1;
  qos.ignore_local = publisher ? kind == 15 : kind >= 10;
  body.qos = abi::pack_qos(qos);
  body.topic = name_of("/t" + std::to_string(up_to(1)));
  body.type = name_of("type");
  std::uint64_t id = 0;
  if (!process.own.empty() && up_to(15) == 0) id = process.own.back().creation;
  ask(process, publisher ? Opcode::create_publisher : Opcode::create_subscription, body, id);
}

void Scenario::say_leave_or_drained(Process& process) {
  const Process& whose = mostly(process);
  if (whose.own.empty()) return;
  const Endpoint& about = one_of(whose.own);
  wire::Reference body{};
  body.kind = about.kind;
  body.topic = about.topic;
  body.index = about.index;
  body.generation = about.generation;
  ask(process, about.left != rarely() ? Opcode::drained : Opcode::leave, body);
}

void Scenario::say_unlinked_endpoint(Process& process) {
  const Process& whose = mostly(process);
  if (whose.notified.empty() || !process.connection) return;
  const auto& [subject, notified] = one_of(whose.notified);
  say_unlinked(process, subject, notified.generation);
}

void Scenario::say_unlinked_region(Process& process) {
  if (process.regions.empty() || !process.connection) return;
  const auto& [owner, notified] = one_of(process.regions);
  say_unlinked(process, {Kind::region, 0, owner}, notified.generation);
}

void Scenario::say_unlinked(Process& process, const Announced& subject, std::uint64_t generation) {
  wire::Unlinked body{};
  body.kind = subject.kind;
  body.topic = subject.topic;
  body.index = subject.index;
  body.generation = generation;
  const std::uint64_t sent = process.packet_count;
  body.seen = sent - std::min(sent, up_to(3));
  if (up_to(31) == 0) body.seen += 2;
  ask(process, Opcode::unlinked, body);
}

// --- the observer's packets

void Scenario::watch() {
  const std::uint64_t id = ++last_request_;
  switch (up_to(5)) {
    case 0: {  // a new connection
      daemon_.connect_observer();
      auto body = make_body<wire::Observe>(Opcode::observe, id);
      body.fingerprint = abi::fingerprint() + (rarely() ? 1 : 0);
      return daemon_.serve_observer(packet_of(body));
    }
    case 1:
      return daemon_.serve_observer(packet_of(make_body<wire::Dump>(Opcode::dump, id)));
    case 2: {
      auto body = make_body<wire::ReadJournal>(Opcode::read_journal, id);
      body.last = rarely() ? any_word() : up_to(200);
      body.count = rarely() ? any_word() : up_to(200);
      return daemon_.serve_observer(packet_of(body));
    }
    default: {
      const Process& whose = any_process();
      auto body = make_body<wire::Revoke>(Opcode::revoke, id);
      body.client = whose.client ? number(*whose.client) : any_word();
      body.generation = whose.generation + (rarely() ? 1 : 0);
      return daemon_.serve_observer(packet_of(body));
    }
  }
}

}  // namespace agnocast::daemon::fuzz
