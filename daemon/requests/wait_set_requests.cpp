// SPDX-License-Identifier: Apache-2.0
//
// WaitSetRequests: see the header.

#include <daemon/requests/wait_set_requests.hpp>

#include <daemon/state/memory_reserve.hpp>
#include <daemon/state/steps.hpp>
#include <journal/cases.hpp>

#include <algorithm>
#include <cstdint>
#include <utility>

namespace agnocast::daemon {

Result<void> WaitSetRequests::admit_wait_set(ClientIndex client, const WaitSetRequest& request) {
  namespace found = journal::request;
  const auto& endpoints = registry_.endpoints_of(client);
  const bool in_use = std::any_of(endpoints.begin(), endpoints.end(), [&](const EndpointRef& ref) {
    return ref.kind == Kind::subscription &&
           registry_.subscription(ref.topic, ref.index).wait_set == request.wait_set;
  });
  const bool is_open = doorbells_.is_open(client, request.wait_set);
  if (journal::decide_request(found::open_wait_set, request.again,
                              !is_open ? found::not_done
                              : in_use ? found::used
                                       : found::done) != journal::RequestDecision::carry_out)
    return fail_with(Errc::protocol_violation, "the wait set is open already");
  if (!is_open) {
    return admission_.admit_wait_set(registry_.client(client).uid);
  }
  ++registry_.counters().requests_answered_again;  // the doorbells were lost with the answer
  return {};
}

Result<void> WaitSetRequests::open_wait_set(Peer& peer, const WaitSetRequest& request) {
  const ClientIndex client = *peer.session.client();
  if (auto admitted = admit_wait_set(client, request); !admitted) return admitted;
  MemoryReserve::no_return();
  auto doorbells = doorbells_.open(client, request.wait_set, registry_.client(client).uid);
  if (!doorbells) return tl::unexpected(doorbells.error());
  AGNOCAST_CRASH_POINT(B_doorbell_bound);
  registry_.open_wait_set(client, static_cast<std::uint32_t>(request.wait_set));
  const auto packet = make_body<wire::Done>(wire::Opcode::wait_set_opened, request.request);
  output_.reply(peer, packet_of(packet), std::move(*doorbells));
  return {};
}

}  // namespace agnocast::daemon
