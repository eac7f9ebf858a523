// SPDX-License-Identifier: Apache-2.0
//
// HelloRequests: see the header.

#include <daemon/requests/hello_requests.hpp>

#include <agnocast/abi/fingerprint.hpp>
#include <base/check.hpp>
#include <daemon/admission/check_caller.hpp>
#include <daemon/state/memory_reserve.hpp>
#include <daemon/transport/brought_windows.hpp>
#include <journal/cases.hpp>

#include <algorithm>
#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::daemon {

using journal::DeathReason;

namespace {

// Places that a hello waits for: a daemon that died twice while it welcomed a process leaves two.
constexpr std::size_t unused_count_max = 4;

}  // namespace

/// The findings about earlier sessions of a process.
struct HelloRequests::Before {
  std::size_t open = 0;  // looks that have not ended
  RegionTrace revoked = RegionTrace::none;
  std::vector<PeerId> unused;  // places of such sessions
  void add(PeerId id, bool is_revoked, RegionTrace trace) {
    if (!is_revoked) {
      if (trace == RegionTrace::none) unused.push_back(id);
    } else if (trace == RegionTrace::some || revoked == RegionTrace::none) {
      revoked = trace;
    }
  }
};

// A daemon that died while it welcomed a process leaves an unused place. A revoked process may not
// come back while it has its region; after exec it is another program.
bool HelloRequests::look_before(Peer& peer, const wire::Hello& hello) {
  if (of_.connections.detached_count() == 0 || peer.revoked_trace) return false;
  const auto before = std::make_shared<Before>();
  const std::uint64_t ticket = of_.scheduler.next_ticket();
  for (const auto& [id, other] : of_.connections.all()) {
    // If a process leaves places behind again and again, look_at_detached() finds the others.
    if (!other->detached || (before->open >= unused_count_max && !other->revoked) ||
        other->session.identity().pid != peer.session.identity().pid ||
        !same_process(other->session.identity().process, peer.session.identity().process))
      continue;
    const bool asked =
        of_.region_look.begin(*other, [this, before, hello, caller = peer.id, ticket, id = id,
                                       revoked = other->revoked](RegionTrace trace) {
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
  of_.scheduler.park(peer, ticket);
  return true;
}

void HelloRequests::welcome_after(PeerId id, std::uint64_t ticket, const wire::Hello& hello,
                                  const Before& before) {
  for (const PeerId unused : before.unused) {
    Peer* const found = of_.connections.find(unused);
    if (found != nullptr && found->detached && !found->revoked)
      of_.termination.reap(*found, DeathReason::unmapped, "process says hello again");
  }
  Peer* const peer = of_.scheduler.unpark(id, ticket);
  if (peer == nullptr) return;
  peer->revoked_trace = before.revoked;
  of_.server.serve_packet(*peer, std::as_bytes(std::span(&hello, 1)), {}, {});
}

Result<void> HelloRequests::hello(Peer& peer, const wire::Hello& hello) {
  Session& session = peer.session;
  if (auto known = check_caller(peer.session.identity(), hello.fingerprint); !known) return known;
  if (look_before(peer, hello)) return {};
  if (auto admitted = of_.admission.admit_client(session.identity().uid, peer.counts_as_observer);
      !admitted)
    return admitted;
  switch (std::exchange(peer.revoked_trace, std::nullopt).value_or(RegionTrace::none)) {
    case RegionTrace::none:
      break;
    case RegionTrace::some:
      return fail_with(Errc::revoked, "the session of this process was revoked");
    case RegionTrace::unknown:
      // It may be another program by now. A process that loses its connection says hello again.
      of_.termination.disconnect(peer, "no time to look whether the process was revoked");
      return {};
  }
  return welcome(peer, hello);
}

Result<void> HelloRequests::welcome(Peer& peer, const wire::Hello& hello) {
  Session& session = peer.session;
  std::string_view name;
  AGNOCAST_CHECK(text_of(hello.process_name, name));
  const auto plan = of_.registry.plan_client();
  if (!plan) return tl::unexpected(plan.error());
  const ClientIndex client = plan->index;
  MemoryReserve::no_return();
  if (auto opened = of_.regions.open_client(client, plan->generation); !opened) return opened;
  if (auto kept = of_.store.put(DescriptorStore::process(client), session.identity().process.fd());
      !kept) {
    of_.regions.close_client(client);
    return kept;
  }
  of_.registry.add_client({session.identity().uid, session.identity().gid,
                           static_cast<std::uint32_t>(session.identity().pid), hello.domain, name},
                          *plan);
  const ClientRecord& record = of_.registry.client(client);
  expect_windows(peer);
  session.greet(client);
  of_.connections.set_client(client, &peer);
  auto packet = make_body<wire::Welcome>(wire::Opcode::welcome, hello.header.request);
  packet.fingerprint = abi::fingerprint();
  packet.incarnation = of_.registry.incarnation();
  packet.client = number(client);
  packet.client_generation = record.generation;
  packet.arena_base = of_.arena.base;
  packet.arena_bytes = of_.arena.bytes;
  packet.client_region_bytes = abi::client_region_bytes;
  of_.output.reply(peer, packet_of(packet),
                   {of_.regions.board_reader(), of_.regions.region_writer(client)});
  of_.log.write(LogLevel::debug, "client registered",
                {{"client", number(client)},
                 {"generation", record.generation},
                 {"pid", session.identity().pid},
                 {"uid", session.identity().uid},
                 {"domain", hello.domain},
                 {"name", name}});
  return {};
}

}  // namespace agnocast::daemon
