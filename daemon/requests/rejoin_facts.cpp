// SPDX-License-Identifier: Apache-2.0

#include <daemon/requests/rejoin_facts.hpp>

#include <agnocast/abi/fingerprint.hpp>

namespace agnocast::daemon {

bool names_place(const wire::Rejoin& request, const Registry& registry) noexcept {
  return static_cast<std::uint32_t>(request.client) < registry.client_high();
}

journal::RejoinFacts rejoin_facts(const wire::Rejoin& request, const Registry& registry,
                                  const Rejoiner& who) {
  journal::RejoinFacts facts;
  facts.same_layout = request.fingerprint == abi::fingerprint();
  facts.confirmed = who.confirmed;
  facts.same_incarnation = request.incarnation == registry.incarnation();
  facts.same_process = who.has_owner && who.same_process;
  if (!names_place(request, registry)) return facts;
  const ClientIndex client{static_cast<std::uint32_t>(request.client)};
  facts.same_generation = registry.client(client).generation == request.client_generation;
  if (registry.client(client).state != ClientState::free)
    facts.state =
        registry.is_alive(client) && who.has_owner ? journal::rejoin::alive : journal::rejoin::dead;
  return facts;
}

}  // namespace agnocast::daemon
