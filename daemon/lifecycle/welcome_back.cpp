// SPDX-License-Identifier: Apache-2.0
//
// WelcomeBack: see the header.

#include <daemon/lifecycle/welcome_back.hpp>

#include <daemon/state/memory_reserve.hpp>

#include <utility>

namespace agnocast::daemon {

void WelcomeBack::begin(ClientIndex client) {
  unannounced_.erase(client);  // what was left for its former connection
  Unannounced rest;
  // A process is notified only about topics in which it has endpoints; with the last one it has
  // acknowledged everything there.
  for (const EndpointRef& ref : registry_.endpoints_of(client)) {
    rest.own.emplace(registry_.generation_of(ref), ref);
    rest.topics.insert(ref.topic);
  }
  rest.endpoints = rest.own;
  announce_more(client, std::move(rest));
}

void WelcomeBack::go_on() {
  for (auto& [client, rest] : std::exchange(unannounced_, {})) {
    if (MemoryReserve::refill()) {
      announce_more(client, std::move(rest));
    } else {
      unannounced_.insert_or_assign(client, std::move(rest));
    }
  }
}

// Without a connection, all of this begins anew when the process is back.
void WelcomeBack::announce_more(ClientIndex client, Unannounced rest) {
  while (rest.next_region < registry_.client_high()) {
    Session* const session = channel_.session_of(client);
    if (session == nullptr) return;
    const bool is_full = session->queued_count() >= Session::queue_count_max / 2;
    if (is_full || (session->is_crowded() && session->has_output())) {
      unannounced_.insert_or_assign(client, std::move(rest));
      return;
    }
    announce_next(client, rest);
  }
  announcer_.send_missed_notices(client);
}

void WelcomeBack::announce_next(ClientIndex client, Unannounced& rest) {
  const auto is_there = [this](std::uint64_t generation, const EndpointRef& ref) {
    return registry_.is_used(ref) && registry_.generation_of(ref) == generation;
  };
  if (!rest.own.empty()) {
    const auto node = rest.own.extract(rest.own.begin());
    if (is_there(node.key(), node.mapped())) runner_.run(announcing_.own(node.mapped()));
  } else if (!rest.endpoints.empty()) {
    const auto node = rest.endpoints.extract(rest.endpoints.begin());
    if (is_there(node.key(), node.mapped())) runner_.run(announcing_.to_owner(node.mapped()));
  } else if (!rest.topics.empty()) {
    runner_.run(announcing_.what_is_over(client, rest.topics.extract(rest.topics.begin()).value()));
  } else {
    announcer_.announce_region(client, static_cast<ClientIndex>(rest.next_region++));
  }
}

}  // namespace agnocast::daemon
