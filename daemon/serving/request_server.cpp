// SPDX-License-Identifier: Apache-2.0
//
// RequestServer: see the header.

#include <daemon/serving/request_server.hpp>

#include <daemon/state/memory_reserve.hpp>
#include <daemon/transport/brought_windows.hpp>

#include <cerrno>
#include <cstring>
#include <new>
#include <string>
#include <string_view>

namespace agnocast::daemon {

RequestServer::RequestServer(Admission& admission, AddressConflicts& conflicts,
                             RefusalReport& refusals, ClientTermination& termination)
    : admission_(admission), conflicts_(conflicts), refusals_(refusals), termination_(termination) {
  handlers_.add(*this, &RequestServer::reject);
}

// The one place where a request may fail for lack of memory. Before its first change it is as if
// it had never come; from then on the reserve serves.
template <class Serve>
void RequestServer::serve_or_refuse(Peer& peer, std::uint64_t id, Serve serve_it) {
  try {
    if (!MemoryReserve::refill()) throw std::bad_alloc();
    const MemoryReserve::MayFail may_fail;
    serve_it();
    return;
  } catch (const std::bad_alloc&) {
  }
  // Ending a connection never fails, so the peer is still there.
  const Request request = Rejected{id, Errc::limit_reached, std::string(no_memory_text), false};
  refusals_.report(peer, request, id, Errc::limit_reached, ENOMEM, no_memory_text);
}

void RequestServer::serve_packet(Peer& peer, std::span<const std::byte> bytes,
                                 const Envelope& envelope, std::span<UniqueFd> fds) {
  wire::Header header{};
  if (bytes.size() >= sizeof header) std::memcpy(&header, bytes.data(), sizeof header);
  serve_or_refuse(peer, header.request,
                  [&] { serve(peer, decode(bytes, envelope, peer.session.role()), fds); });
}

void RequestServer::serve_again(Peer& peer, const Request& request) {
  serve_or_refuse(peer, request_id_of(request), [&] { serve(peer, request, {}); });
}

void RequestServer::serve(Peer& peer, const Request& request, std::span<UniqueFd> fds) {
  admission_.begin_request();
  conflicts_.begin_request();
  if (std::holds_alternative<CreateRequest>(request) ||
      std::holds_alternative<wire::WindowRequest>(request) ||
      std::holds_alternative<WaitSetRequest>(request))
    expect_no_windows(peer);
  const std::uint64_t id = request_id_of(request);  // the handler may end the peer
  const Result<void> served = handlers_.serve(peer, request, fds);
  if (served) return;
  // It ended between two services; another process may have its place by now.
  if (!peer.session.greeted() && peer.session.identity().process.ended()) return;
  const std::string_view detail = detail_of(served.error());
  const std::string why(detail.empty() ? served.error().what : detail);
  refusals_.report(peer, request, id, served.error().code, served.error().os_errno, why);
  const auto* const rejected = std::get_if<Rejected>(&request);
  if (rejected != nullptr && rejected->ends_connection)
    termination_.disconnect(peer, "a packet could not be parsed");
}

Result<void> RequestServer::reject(Peer&, const Rejected& rejected) {
  return fail_with(rejected.code, rejected.text);
}

}  // namespace agnocast::daemon
