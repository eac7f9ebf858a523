// SPDX-License-Identifier: Apache-2.0
//
// EndpointRequests: see the header.

#include <daemon/requests/endpoint_requests.hpp>

#include <base/clock.hpp>
#include <base/text/names.hpp>

#include <string>
#include <string_view>

namespace agnocast::daemon {

namespace {

const char* name_of_kind(Kind kind) noexcept {
  return kind == Kind::publisher ? "publisher" : "subscription";
}

}  // namespace

Result<void> EndpointRequests::create(Peer& peer, const CreateRequest& request) {
  const ClientIndex client = *peer.session.client();
  const ClientRecord& record = registry_.client(client);
  if (request.again && endpoint_manager_.answer_again(client, request)) return {};
  if (const auto problem = check_topic_name(request.topic))
    return fail_with(Errc::invalid_name,
                     "topic " + printable(request.topic) + ": " + problem->text());
  if (auto admitted = admission_.admit_endpoint(peer.session.identity(), client, request);
      !admitted)
    return admitted;
  const auto waits = clear_before(peer, request);
  if (!waits) return tl::unexpected(waits.error());
  if (*waits) return {};
  // Set before any process is notified of the publisher, and with it of the heap.
  const bool is_first = request.kind == Kind::publisher && record.readers == 0;
  if (is_first)
    registry_.set_readers(
        client, readers_of(config_.access, request.domain.value_or(record.domain), request.topic));
  auto created = endpoint_manager_.create(client, request);
  if (!created && is_first) registry_.set_readers(client, 0);
  if (created && request.kind == Kind::subscription) readers_.created(client, request);
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

Result<void> EndpointRequests::leave(Peer& peer, const LeaveRequest& request) {
  return endpoint_manager_.leave(*peer.session.client(), request);
}

// A process may write to the file of its region, and so keep it locked: waiting for that is an
// errand of its user, and the request is parked.
Result<bool> EndpointRequests::clear_before(Peer& peer, const CreateRequest& request) {
  const ClientIndex client = *peer.session.client();
  const std::uint64_t bytes = endpoint_manager_.extent_bytes(client, request);
  const auto offset = registry_.lowest_extent(client, bytes);
  if (!offset || regions_.is_clear(client, {*offset, bytes})) return false;
  const std::uint64_t ticket = scheduler_.next_ticket();
  const auto cleared = regions_.clear(
      client, {registry_.client(client).uid, config_.region_bytes()}, {*offset, bytes},
      [this, id = peer.id, ticket, request, here = std::weak_ptr(here_)] {
        if (here.expired()) return;
        std::erase_if(uncleared_, [&](const Uncleared& one) { return one.ticket == ticket; });
        Peer* const back = scheduler_.unpark(id, ticket);
        if (back == nullptr) return;
        server_.serve_again(*back, request);
      });
  if (!cleared) return tl::unexpected(cleared.error());
  uncleared_.push_back({peer.id, ticket, request.request, monotonic_ms() + clearing_ms});
  scheduler_.park(peer, ticket);
  return true;
}

void EndpointRequests::refuse_uncleared(std::uint64_t now) {
  while (!uncleared_.empty() && uncleared_.front().until_ms <= now) {
    const Uncleared waits = uncleared_.front();
    uncleared_.pop_front();
    Peer* const peer = scheduler_.unpark(waits.id, waits.ticket);
    if (peer == nullptr) continue;  // it has gone, or come back on another connection
    constexpr std::string_view why =
        "memory for the endpoint could not be prepared in time: this process, or another one of "
        "its user, keeps agnocastd waiting";
    const Request request = Rejected{waits.request, Errc::limit_reached, std::string(why), false};
    refusals_.report(*peer, request, waits.request, Errc::limit_reached, 0, why);
  }
}

}  // namespace agnocast::daemon
