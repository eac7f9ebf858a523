// SPDX-License-Identifier: Apache-2.0

#include <ros2/rmw_agnocast_cpp/core/services.hpp>

#include <agnocast/heap.hpp>
#include <agnocast/relay.hpp>

#include <algorithm>

namespace agnocast::rmw {
namespace {

using Kind = agnocast::detail::GenericServiceKind;

Kind kind_of(const ServiceSupport& support) noexcept {
  return Kind({support.request.type(), support.response.type()});
}

/// Whether the reason lies in this process, and not with the other side: also agnocastd's refusal
/// of the publisher of responses to one client is of that client.
bool is_of_this_process(Errc code) noexcept {
  constexpr Errc own[] = {Errc::shut_down,       Errc::switched_off,     Errc::revoked,
                          Errc::heap_exhausted,  Errc::window_exhausted, Errc::loan_invalid,
                          Errc::user_code_threw, Errc::internal};
  return std::find(std::begin(own), std::end(own), code) != std::end(own);
}

/// Copies a message of the node into a loan.
Result<void> fill(const MessageSupport& support, const void* from, GenericLoan& loan) {
  if (const CLayout* const layout = support.c_layout()) return layout->to_cpp(from, loan.get());
  support.type().assign(from, loan.get());
  return {};
}

}  // namespace

Result<std::unique_ptr<ServiceServer>> ServiceServer::create(const NodeName& node,
                                                             const std::string& service,
                                                             const ServiceSupport& support,
                                                             const QoS& qos) {
  const Kind kind = kind_of(support);
  const auto name = agnocast::detail::resolve_service(node, service);
  if (!name) return tl::unexpected<Failure>(name.error());
  const auto types = kind.types();
  if (!types) return tl::unexpected<Failure>(types.error());
  auto untyped = agnocast::detail::UntypedService::create(
      *name, *types, qos, kind.response_code().code(), nullptr, nullptr);
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  return std::unique_ptr<ServiceServer>(
      new ServiceServer(support, std::move(*untyped), kind, *name));
}

bool ServiceServer::take(void* request, RequestId& id) {
  // A client may send malformed requests without end.
  constexpr int dropped_max = 64;
  for (int dropped = 0; dropped < dropped_max; ++dropped) {
    agnocast::detail::Block* const block = untyped_->take();
    if (block == nullptr) return false;
    const auto taken = agnocast::detail::request_of(kind_, *untyped_->core(), block);
    const WindowSet windows = windows_of(taken.message());
    if (!support_.request.to_node(taken.message().get(), request, windows)) continue;
    id = taken.id();
    return true;
  }
  return false;
}

Result<void> ServiceServer::send(const RequestId& id, const void* response) {
  GenericLoan loan = responder_.borrow();
  if (Result<void> filled = fill(support_.response, response, loan); !filled) return filled;
  const PublishResult sent = responder_.send(id, loan);
  if (sent) return {};
  if (is_of_this_process(sent.code)) return fail(sent.code, "sending a response");
  undelivered_.fetch_add(1, std::memory_order_relaxed);
  return {};
}

Result<std::unique_ptr<ServiceClient>> ServiceClient::create(const NodeName& node,
                                                             const std::string& service,
                                                             const ServiceSupport& support,
                                                             const QoS& qos) {
  const Kind kind = kind_of(support);
  const auto name = agnocast::detail::resolve_service(node, service);
  if (!name) return tl::unexpected<Failure>(name.error());
  const auto types = kind.types();
  if (!types) return tl::unexpected<Failure>(types.error());
  auto untyped = agnocast::detail::UntypedClient::create_polled(*name, *types, qos,
                                                                kind.request_code().code());
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  std::unique_ptr<ServiceClient> made(
      new ServiceClient(support, std::move(*untyped), kind, name->domain));
  // rclcpp asks once whether a server is there, and again when the graph changes or after 100 ms.
  made->wait_for_own_server(std::chrono::milliseconds(100));
  return made;
}

bool ServiceClient::ServerArrival::is_ready() const noexcept {
  try {
    const LoanPause pause;
    return client_.service_is_ready();
  } catch (const std::bad_alloc&) {
    return false;  // the next look may have memory
  }
}

bool ServiceClient::is_ready() const noexcept {
  if (::getpid() != process_) return false;
  // Nothing moves from the unread ones to the inbox meanwhile.
  const std::lock_guard polling(polling_);
  if (client_.untyped().has_unread()) return true;
  const std::lock_guard lock(inbox_->mutex);
  return !inbox_->responses.empty();
}

Arrivals ServiceClient::arrivals() const noexcept {
  if (::getpid() != process_) return {};
  const std::lock_guard polling(polling_);
  Arrivals now = client_.untyped().arrivals();
  const std::lock_guard lock(inbox_->mutex);
  now.unread += inbox_->responses.size();
  return now;
}

/// Waits, if there is one, until it is matched, or both have been there for so long.
void ServiceClient::wait_for_own_server(std::chrono::milliseconds age) const {
  if (server_count() != 0 || ::getpid() != process_) return;
  bool has_server = false;
  auto newest = created_;
  OwnEndpoint<Clock::time_point>::visit(domain_, client_.get_service_name(),
                                        [&](Clock::time_point since) {
                                          has_server = true;
                                          newest = std::max(newest, since);
                                        });
  if (!has_server) return;
  const auto end = newest + age;
  const auto now = Clock::now();
  if (now < end) (void)client_.wait_for_service(end - now);
}

Result<std::int64_t> ServiceClient::send(const void* request) {
  // Somebody may have held a lock when this process was forked.
  if (::getpid() != process_) return fail(Errc::shut_down, "sending a request in a forked child");
  wait_for_own_server(std::chrono::seconds(1));
  {
    // Ends those whose server has gone; nobody takes for them.
    const LoanPause pause;  // the inbox is private memory
    const std::lock_guard lock(polling_);
    client_.untyped().poll();
  }
  GenericLoan loan = client_.borrow_loaned_request();
  if (Result<void> filled = fill(support_.request, request, loan); !filled)
    return tl::unexpected<Failure>(filled.error());
  const std::int64_t number = last_.fetch_add(1, std::memory_order_relaxed) + 1;
  const auto sent = client_.try_async_send_request(
      std::move(loan), [inbox = inbox_, number](const Client::SharedFuture& response) {
        try {
          GenericMessage message = response.get();
          const std::lock_guard lock(inbox->mutex);
          inbox->responses.push_back({number, std::move(message)});
        } catch (const Error&) {
          // Its server has ended: as in DDS, nothing comes.
        }
      });
  if (sent) {
    const std::lock_guard lock(polling_);
    while (client_.untyped().pending_count() > unanswered_max)
      client_.remove_pending_request(++given_up_);
    return number;
  }
  if (is_of_this_process(sent.error().code)) return tl::unexpected<Failure>(sent.error());
  dropped_.fetch_add(1, std::memory_order_relaxed);
  return number;
}

bool ServiceClient::take(void* response, std::int64_t& number) {
  if (::getpid() != process_) return false;
  {
    const LoanPause pause;
    const std::lock_guard lock(polling_);
    client_.untyped().poll();
  }
  for (;;) {
    Response next;
    {
      const std::lock_guard lock(inbox_->mutex);
      if (inbox_->responses.empty()) return false;
      next = std::move(inbox_->responses.front());
      inbox_->responses.pop_front();
    }
    const WindowSet windows = windows_of(next.message);
    if (!support_.response.to_node(next.message.get(), response, windows)) continue;
    number = next.number;
    return true;
  }
}

}  // namespace agnocast::rmw
