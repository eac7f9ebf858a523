// SPDX-License-Identifier: Apache-2.0
//
// WindowRequests: see the header.

#include <daemon/requests/window_requests.hpp>

#include <daemon/state/memory_reserve.hpp>
#include <daemon/state/steps.hpp>
#include <daemon/transport/shared_fd.hpp>
#include <journal/cases.hpp>

#include <string>
#include <utility>

namespace agnocast::daemon {

Result<void> WindowRequests::open_window(Peer& peer, const wire::WindowRequest& request) {
  const ClientIndex client = *peer.session.client();
  const ClientRecord& record = registry_.client(client);
  if (request.window > record.window_count)
    return fail_with(Errc::protocol_violation, "windows are opened one after the other");
  Result<SharedFd> writer = SharedFd();
  if (request.window < record.window_count) {
    ++registry_.counters().requests_answered_again;
    writer = regions_.window_writer(client, request.window);  // a repeated request
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
    // Before the answer: a subscriber's socket has the announcement before the window has a
    // message.
    endpoint_manager_.announce_window(client);
    log_.write(LogLevel::debug, "window opened",
               {{"client", number(client)},
                {"pid", peer.session.identity().pid},
                {"window", request.window},
                {"first", window->first},
                {"base", hexadecimal(window->base)},
                {"bytes", arena_.window_bytes}});
    conflicts_.look_at_publishers_of(client);
  }
  auto packet = make_body<wire::WindowOpened>(wire::Opcode::window_opened, request.header.request);
  packet.window = request.window;
  packet.base = record.window[request.window].base;
  packet.bytes = record.window[request.window].bytes;
  packet.first = record.window[request.window].first;
  output_.reply(peer, packet_of(packet),
                {*writer, regions_.window_readers(client)[request.window]});
  return {};
}

// The contents of a window outlive the daemon that gave it: its owner, whose peers the new daemon
// does not know yet, keeps it where it is, and its readers find the same memory at the same place.
Result<void> WindowRequests::bring_window(Peer& peer, const wire::BringWindow& request,
                                          std::span<UniqueFd> fds) {
  const UniqueFd& window = fds[0];  // decode() has counted them
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
    facts.possible_window_set =
        request.first == request.window ||
        (request.window != 0 && request.first == record.window[request.window - 1].first);
    allowed = admission_.admit_brought_window(record, request.bytes);
    // If both fail, the text of the later failure is kept and sent.
    ours = Regions::check_window(window.get(), request.base, request.bytes, record.uid);
    facts.room = allowed.has_value();
    facts.ours = ours.has_value();
  }
  facts.free = true;
  MemoryReserve::no_return();
  auto decision = journal::decide_brought(facts);
  if (decision == journal::BroughtDecision::take) {
    facts.free = request.bytes == arena_.window_bytes && plan_.adopt(request.base);
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
                       facts.number == brought::known ? "another window has this number"
                       : facts.number == brought::later
                           ? "windows are brought one after the other"
                           : "a window that cannot be of this window set");
    case journal::BroughtDecision::permission_denied:
      return ours;
    case journal::BroughtDecision::over_limit:
      return allowed;
    case journal::BroughtDecision::arena_occupied:
      return fail_with(Errc::arena_occupied,
                       "the window at " + hexadecimal(request.base) +
                           " is another process's, or outside [heap] arena_base and arena_bytes");
  }
  if (auto taken = take_brought(peer, request, window); !taken) return taken;
  return done();
}

Result<void> WindowRequests::take_brought(const Peer& peer, const wire::BringWindow& request,
                                          const UniqueFd& window) {
  const ClientIndex client = *peer.session.client();
  AGNOCAST_CRASH_POINT(B_window_base);
  if (auto kept = regions_.bring_window(client, window); !kept) {
    plan_.give_back(request.base);
    return kept;
  }
  AGNOCAST_CRASH_POINT(B_window_made);
  registry_.open_window(client, {request.base, request.bytes, request.first});
  endpoint_manager_.announce_window(client);
  log_.write(LogLevel::debug, "window brought",
             {{"client", number(client)},
              {"pid", peer.session.identity().pid},
              {"window", request.window},
              {"base", hexadecimal(request.base)}});
  conflicts_.look_at_publishers_of(client);
  return {};
}

}  // namespace agnocast::daemon
