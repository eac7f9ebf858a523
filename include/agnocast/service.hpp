// SPDX-License-Identifier: Apache-2.0
//
// Service: answers requests, at once or later. A callback gets the request and fills a response,
// or it gets the request alone and any thread sends the response later. Requests are received
// messages, responses are loans, so nothing is copied. See docs/services.md.
#pragma once

#include <agnocast/core_namespace.hpp>
#include <agnocast/service_message.hpp>
#include <agnocast/subscription.hpp>

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

namespace agnocast {

namespace detail {

class ServiceCore;

/// Requests, and one publisher of responses for each client, independent of the message types.
class AGNOCAST_PUBLIC UntypedService {
 public:
  /// Takes over one reference to a request, which points behind its header.
  using Callback = std::function<void(const std::shared_ptr<ServiceCore>&, Block* request)>;

  /// Without a callback, requests are for take().
  [[nodiscard]] static Result<std::shared_ptr<UntypedService>> create(
      const EndpointName& service, const ServiceTypes& types, const QoS& qos,
      const MessageCode& response, Callback callback, const CallbackGroup::SharedPtr& group);
  ~UntypedService();
  UntypedService(const UntypedService&) = delete;
  UntypedService& operator=(const UntypedService&) = delete;

  const std::shared_ptr<ServiceCore>& core() const noexcept { return core_; }
  static LenderId lender_of(const ServiceCore& core) noexcept;
  const std::string& service() const noexcept;
  std::size_t client_count() const noexcept;
  std::uint64_t undelivered_count() const noexcept;
  std::uint64_t callback_exception_count() const noexcept;
  bool is_active() const noexcept;
  std::size_t refused_client_count() const noexcept;
  Failure last_refusal() const noexcept;
  /// Takes the oldest unread request, which points behind its header; null: none. For a service
  /// without a callback.
  Block* take() noexcept;
  /// Returns whether take() may find one. No system call.
  bool has_unread() const noexcept;
  Arrivals arrivals() noexcept;

  /// Returns the publisher of responses to `client`. Never waits. Errors: endpoint_gone (the
  /// client or this service has ended), would_block (the publisher is being created), and the
  /// code of the daemon's refusal.
  static Result<std::shared_ptr<UntypedPublisher>> publisher_to(ServiceCore& core,
                                                                std::uint64_t client) noexcept;
  static void count_undelivered(ServiceCore& core) noexcept;

 private:
  explicit UntypedService(std::shared_ptr<ServiceCore> core) noexcept : core_(std::move(core)) {}
  std::shared_ptr<ServiceCore> core_;
};

/// The right to answer one request, once.
struct Ticket {
  RequestId id;
  std::uint64_t service = 0;  // its LenderId
  std::atomic<bool> is_answered{false};
};

template <class Kind>
class BasicService;

/// Lends responses and sends them.
template <class Kind>
class Responder : public Lender<typename Kind::Response, typename Kind::ResponseCode> {
 public:
  Responder(std::shared_ptr<ServiceCore> core, const Kind& kind) noexcept
      : Lender<typename Kind::Response, typename Kind::ResponseCode>(
            UntypedService::lender_of(*core), kind.response_code()),
        core_(std::move(core)),
        kind_(kind) {}

  typename Kind::ResponseLoan borrow() const { return kind_.response_loan(this->lend()); }
  PublishResult send(const RequestId& to, typename Kind::ResponseLoan& response) const noexcept {
    const auto publisher = UntypedService::publisher_to(*core_, to.client);
    if (!publisher) return {publisher.error().code, 0};
    return this->take_back(std::move(Kind::handle(response)),
                           [&](typename Kind::ResponseCode::Owner&& message) {
                             id_of(message.get()) = to;
                             return commit(**publisher, this->code(), std::move(message));
                           });
  }
  const std::shared_ptr<ServiceCore>& core() const noexcept { return core_; }
  const Kind& kind() const noexcept { return kind_; }

 private:
  std::shared_ptr<ServiceCore> core_;
  Kind kind_;
};

/// A request that is answered later. All copies are the same request.
template <class Kind>
class BasicServiceRequest {
 public:
  BasicServiceRequest() noexcept = default;
  /// For the library.
  BasicServiceRequest(typename Kind::RequestMessage message,
                      std::shared_ptr<Ticket> ticket) noexcept
      : message_(std::move(message)), ticket_(std::move(ticket)) {}

  /// Returns the request: read-only memory of the client, held by this object. See release().
  const typename Kind::RequestMessage& message() const noexcept { return message_; }
  decltype(auto) operator*() const noexcept { return *message_; }
  auto operator->() const noexcept { return message_.get(); }
  explicit operator bool() const noexcept { return ticket_ != nullptr; }
  RequestId id() const noexcept { return ticket_ != nullptr ? ticket_->id : RequestId(); }
  /// Releases the message; the request can still be answered. While the service holds 64 requests
  /// of a client, it reads no further ones of it.
  void release() noexcept { message_.reset(); }

 private:
  friend class BasicService<Kind>;
  typename Kind::RequestMessage message_;
  std::shared_ptr<Ticket> ticket_;
};

/// Returns the request of a block, with the right to answer it. Takes over the block.
template <class Kind>
BasicServiceRequest<Kind> request_of(const Kind& kind, const ServiceCore& core, Block* block) {
  const RequestId id = id_of(static_cast<std::byte*>(block->message.load()));
  auto message = kind.request(ipc_shared_ptr<const typename Kind::Request>(block));
  auto ticket = std::make_shared<Ticket>();
  ticket->id = id;
  ticket->service = UntypedService::lender_of(core).value();
  return BasicServiceRequest<Kind>(std::move(message), std::move(ticket));
}

/// The accepted callbacks of create_service.
template <class Kind, class Callback, class Request>
inline constexpr bool fills_response =
    std::is_invocable_v<Callback&, Request, typename Kind::ResponseLoan&>;
template <class Kind, class Callback>
inline constexpr bool answers_later = std::is_invocable_v<Callback&, BasicServiceRequest<Kind>>;

/// Wraps a callback that takes a request and a response to fill, sent when it returns, or the
/// request alone.
template <class Kind, class Callback>
UntypedService::Callback erase_service(const Kind& kind, Callback&& callback) {
  using Function = std::decay_t<Callback>;
  using Read = ipc_shared_ptr<const typename Kind::Request>;
  using Writable = typename Kind::WritableRequestMessage;
  constexpr bool reads = fills_response<Kind, Function, typename Kind::RequestMessage>;
  constexpr bool fills = reads || fills_response<Kind, Function, Writable>;
  static_assert(fills || answers_later<Kind, Function>,
                "a service's callback takes agnocast::ipc_shared_ptr<const Request> and "
                "agnocast::ipc_shared_ptr<Response>&, or for a response that is sent later "
                "agnocast::ServiceRequest<T> alone");
  return [kind, function = std::forward<Callback>(callback)](
             const std::shared_ptr<ServiceCore>& core, Block* block) mutable {
    if constexpr (fills) {
      const RequestId id = id_of(static_cast<std::byte*>(block->message.load()));
      std::conditional_t<reads, typename Kind::RequestMessage, Writable> request = [&] {
        if constexpr (reads) {
          return kind.request(Read(block));
        } else {
          return Writable(block);
        }
      }();
      const Responder<Kind> responder(core, kind);
      typename Kind::ResponseLoan response = responder.borrow();
      function(std::move(request), response);
      if (!responder.send(id, response)) UntypedService::count_undelivered(*core);
    } else {
      function(request_of(kind, *core, block));
    }
  };
}

/// Service and GenericService; `Kind` is TypedService or GenericServiceKind. Any thread may call
/// any function.
template <class Kind>
class BasicService {
 public:
  using Request = BasicServiceRequest<Kind>;
  using Response = typename Kind::ResponseLoan;

  BasicService(std::shared_ptr<UntypedService> untyped, const Kind& kind) noexcept
      : untyped_(std::move(untyped)), responder_(untyped_->core(), kind) {}

  /// Lends a response to fill, for any request of this service. See
  /// Publisher::borrow_loaned_message.
  Response borrow_loaned_response() { return responder_.borrow(); }
  /// Call it before another thread gets the loan: see Publisher::pause.
  bool pause(const Response& response) noexcept { return responder_.pause(Kind::handle(response)); }
  /// Sends a loan of this service to the client of `request`; every copy of it becomes empty. Any
  /// order of requests. Never waits. On failure `response` is unchanged, and the request can be
  /// answered again. Errors: already_answered; endpoint_gone (the client has ended); would_block
  /// (it has as many unread responses as the depth allows, or its publisher is being created);
  /// invalid_argument (not a request of this service); loan_invalid, those of PublishResult, and
  /// the code of get_last_refusal() for a refused client.
  PublishResult send_response(const Request& request, Response&& response) noexcept {
    Ticket* const ticket = request.ticket_.get();
    if (ticket == nullptr ||
        ticket->service != UntypedService::lender_of(*untyped_->core()).value())
      return {Errc::invalid_argument, 0};
    if (ticket->is_answered.exchange(true)) return {Errc::already_answered, 0};
    const PublishResult sent = responder_.send(ticket->id, response);
    if (!sent) ticket->is_answered = false;
    return sent;
  }

  const char* get_service_name() const noexcept { return untyped_->service().c_str(); }
  /// Returns the number of clients that can be answered.
  std::size_t get_client_count() const noexcept { return untyped_->client_count(); }
  /// Returns the number of connected clients that cannot be answered, because agnocastd refused
  /// the necessary publisher for a limit, a quota or a rule. The service asks again every second;
  /// to these clients it is not ready.
  std::size_t get_refused_client_count() const noexcept { return untyped_->refused_client_count(); }
  /// Returns the last refusal; code ok if there was none.
  Failure get_last_refusal() const noexcept { return untyped_->last_refusal(); }
  /// Returns the number of responses filled by a callback that could not be sent: the client had
  /// ended, does not read, or has no publisher yet.
  std::uint64_t get_undelivered_response_count() const noexcept {
    return untyped_->undelivered_count();
  }
  /// As in SubscriptionBase.
  std::uint64_t get_callback_exception_count() const noexcept {
    return untyped_->callback_exception_count();
  }
  bool is_active() const noexcept { return untyped_->is_active(); }

 private:
  std::shared_ptr<UntypedService> untyped_;
  Responder<Kind> responder_;
};

template <class Made, class Kind, class Node, class Callback>
Result<std::shared_ptr<Made>> make_service(Node& node, const std::string& service, Kind kind,
                                           Callback&& callback, const QoS& qos,
                                           const GroupOf<Node>& group) {
  const Result<EndpointName> name = resolve_service(dereference(node), service);
  if (!name) return tl::unexpected<Failure>(name.error());
  const Result<ServiceTypes> types = kind.types();
  if (!types) return tl::unexpected<Failure>(types.error());
  auto adapted = AdapterOf<Node>::group(dereference(node), group);
  if (!adapted) return tl::unexpected<Failure>(adapted.error());
  auto untyped =
      UntypedService::create(*name, *types, qos, kind.response_code().code(),
                             erase_service(kind, std::forward<Callback>(callback)), *adapted);
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  return std::make_shared<Made>(std::move(*untyped), kind);
}

}  // namespace detail

AGNOCAST_CORE_BEGIN

/// The argument of a callback that answers later, with Service::send_response(): from any thread,
/// in any order, or never.
template <class ServiceT>
using ServiceRequest = detail::BasicServiceRequest<detail::TypedService<ServiceT>>;

/// A service of type ServiceT: any type with a Request and a Response that can be messages
/// (message_traits.hpp), such as example_interfaces::srv::AddTwoInts with <agnocast/rosidl.hpp>.
template <class ServiceT>
class Service : public detail::BasicService<detail::TypedService<ServiceT>> {
 public:
  using SharedPtr = std::shared_ptr<Service>;
  using detail::BasicService<detail::TypedService<ServiceT>>::BasicService;
};

/// Creates a service. `callback` takes either ipc_shared_ptr<const Request> (or of Request) and
/// ipc_shared_ptr<Response>&, which is sent when it returns, or a ServiceRequest<ServiceT> to
/// answer later; it runs in `group` (null: the default group of the node). Of `qos` only the depth
/// is used: the limit for unread requests of one client, and for responses that it has not read.
/// Errors: those of try_create_client.
template <class ServiceT, class Node, class Callback>
[[nodiscard]] Result<typename Service<ServiceT>::SharedPtr> try_create_service(
    Node&& node, const std::string& service, Callback&& callback, const QoS& qos = ServicesQoS(),
    const detail::GroupOf<Node>& group = nullptr) {
  return detail::make_service<Service<ServiceT>>(node, service, detail::TypedService<ServiceT>(),
                                                 std::forward<Callback>(callback), qos, group);
}
/// The same; throws Error.
template <class ServiceT, class Node, class Callback>
typename Service<ServiceT>::SharedPtr create_service(Node&& node, const std::string& service,
                                                     Callback&& callback,
                                                     const QoS& qos = ServicesQoS(),
                                                     const detail::GroupOf<Node>& group = nullptr) {
  auto made =
      try_create_service<ServiceT>(node, service, std::forward<Callback>(callback), qos, group);
  if (!made) detail::throw_error(made.error());
  return std::move(*made);
}

AGNOCAST_CORE_END

}  // namespace agnocast
