// SPDX-License-Identifier: Apache-2.0
//
// Client: sends requests to a service and receives the responses. Names and signatures follow
// rclcpp; requests are loans and responses are received messages, so nothing is copied. How a
// service is built from topics, and what happens when a side dies: docs/services.md.
#pragma once

#include <agnocast/core_namespace.hpp>
#include <agnocast/heap.hpp>
#include <agnocast/service_message.hpp>
#include <agnocast/subscription.hpp>

#include <chrono>
#include <cstdint>
#include <exception>
#include <functional>
#include <future>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace agnocast {

namespace detail {

class ClientCore;

/// Requests and their pending responses, independent of the message types.
class AGNOCAST_PUBLIC UntypedClient {
 public:
  /// Called once per request: with a response (one reference to it), or with null and the reason.
  using Completion = std::function<void(Block* response, Errc why)>;

  [[nodiscard]] static Result<std::shared_ptr<UntypedClient>> create(
      const EndpointName& service, const ServiceTypes& types, const QoS& qos,
      const MessageCode& request, const CallbackGroup::SharedPtr& group,
      std::function<bool()> is_over);
  /// The same without a callback group: poll() calls the completions.
  [[nodiscard]] static Result<std::shared_ptr<UntypedClient>> create_polled(
      const EndpointName& service, const ServiceTypes& types, const QoS& qos,
      const MessageCode& request);
  ~UntypedClient();
  UntypedClient(const UntypedClient&) = delete;
  UntypedClient& operator=(const UntypedClient&) = delete;

  UntypedPublisher& requests() const noexcept;
  /// Registers a request and returns its id. Errors: no_server, shut_down, revoked, switched_off.
  [[nodiscard]] Result<RequestId> begin(Completion completion);
  bool remove(std::int64_t request) noexcept;
  std::size_t prune() noexcept;
  std::size_t prune_older_than(std::chrono::system_clock::time_point time,
                               std::vector<std::int64_t>* pruned);
  std::size_t server_count() const;
  /// `timeout`: at most a hundred years.
  bool wait(std::chrono::nanoseconds timeout) const;
  const std::string& service() const noexcept;
  std::size_t pending_count() const noexcept;
  std::uint64_t dropped_count() const noexcept;
  bool is_active() const noexcept;
  /// For a polled client: completes what has been answered, 64 responses at most, and what nobody
  /// can answer any more. One thread at a time. Throws what completions throw.
  void poll();
  /// Returns whether poll() may find a response. No system call.
  bool has_unread() const noexcept { return replies_->has_unread(); }
  Arrivals arrivals() const noexcept { return replies_->arrivals(); }

 private:
  [[nodiscard]] static Result<std::shared_ptr<UntypedClient>> make(
      const EndpointName& service, const ServiceTypes& types, const QoS& qos,
      const MessageCode& request, std::function<bool()> is_over,
      const CallbackGroup::SharedPtr* group);
  UntypedClient(std::shared_ptr<ClientCore> core, std::function<bool()> is_over) noexcept
      : core_(std::move(core)), is_over_(std::move(is_over)) {}
  std::shared_ptr<ClientCore> core_;
  const std::function<bool()> is_over_;  // may be empty
  std::shared_ptr<UntypedSubscription> replies_;
};

}  // namespace detail

/// A future and the number of its request, as in rclcpp.
template <class FutureT>
struct FutureAndRequestId {
  FutureT future;
  std::int64_t request_id;

  FutureAndRequestId(FutureT impl, std::int64_t request) noexcept
      : future(std::move(impl)), request_id(request) {}
  operator FutureT&() noexcept { return future; }
  /// Returns the response; waits for it. Throws Error: no_server, when the server that had the
  /// request ended without answering; std::future_error (broken_promise), when the request was
  /// removed.
  auto get() { return future.get(); }
  bool valid() const noexcept { return future.valid(); }
  void wait() const { future.wait(); }
  template <class Rep, class Period>
  std::future_status wait_for(const std::chrono::duration<Rep, Period>& timeout) const {
    return future.wait_for(timeout);
  }
  template <class Clock, class Duration>
  std::future_status wait_until(const std::chrono::time_point<Clock, Duration>& end) const {
    return future.wait_until(end);
  }
  auto share() noexcept { return future.share(); }
};

/// Functions common to all clients. Any thread may call any of them. Do not wait inside callbacks
/// of the client's own node: its other callbacks cannot run meanwhile.
class ClientBase {
 public:
  const char* get_service_name() const noexcept { return untyped_->service().c_str(); }
  /// Returns whether a server is connected that receives requests sent now and can respond to
  /// this client.
  bool service_is_ready() const { return untyped_->server_count() != 0; }
  /// Returns the number of such servers.
  std::size_t get_server_count() const { return untyped_->server_count(); }
  /// Waits until a server is ready. Returns false when `timeout` is over (negative: no limit),
  /// when the client is not active, in a forked child, and, if the node is rclcpp's, after
  /// rclcpp::shutdown() unless one is ready.
  template <class Rep = std::int64_t, class Period = std::milli>
  bool wait_for_service(
      std::chrono::duration<Rep, Period> timeout = std::chrono::duration<Rep, Period>(-1)) const {
    using Given = std::chrono::duration<double>;  // has room for every duration
    constexpr std::chrono::hours for_ever{24 * 365};
    const bool is_limited = timeout.count() >= 0 && Given(timeout) < Given(for_ever);
    return untyped_->wait(is_limited ? std::chrono::duration_cast<std::chrono::nanoseconds>(timeout)
                                     : for_ever);
  }
  /// Cancels a request: its future breaks, its callback is not called, and its response is
  /// dropped. Returns false if the response has arrived, or there is no such request.
  bool remove_pending_request(std::int64_t request) noexcept { return untyped_->remove(request); }
  template <class FutureT>
  bool remove_pending_request(const FutureAndRequestId<FutureT>& request) noexcept {
    return untyped_->remove(request.request_id);
  }
  /// Cancels all pending requests. Returns their number.
  std::size_t prune_pending_requests() noexcept { return untyped_->prune(); }
  /// Cancels the requests sent before `time`, and appends their ids to `pruned` unless it is
  /// null. Returns their number.
  std::size_t prune_requests_older_than(std::chrono::system_clock::time_point time,
                                        std::vector<std::int64_t>* pruned = nullptr) {
    return untyped_->prune_older_than(time, pruned);
  }
  std::size_t get_pending_request_count() const noexcept { return untyped_->pending_count(); }
  /// Responses without a pending request: for removed requests, and second responses from other
  /// servers.
  std::uint64_t get_dropped_response_count() const noexcept { return untyped_->dropped_count(); }
  /// As PublisherBase::is_active().
  bool is_active() const noexcept { return untyped_->is_active(); }

 protected:
  explicit ClientBase(std::shared_ptr<detail::UntypedClient> untyped) noexcept
      : untyped_(std::move(untyped)) {}
  ~ClientBase() = default;
  detail::UntypedClient& untyped() const noexcept { return *untyped_; }

 private:
  std::shared_ptr<detail::UntypedClient> untyped_;
};

namespace detail {

/// Client and GenericClient; `Kind` is TypedService or GenericServiceKind.
template <class Kind>
class BasicClient : public ClientBase,
                    public Lender<typename Kind::Request, typename Kind::RequestCode> {
 public:
  using SharedResponse = typename Kind::ResponseMessage;
  using Promise = std::promise<SharedResponse>;
  using Future = std::future<SharedResponse>;
  using SharedFuture = std::shared_future<SharedResponse>;
  using Request = typename Kind::RequestLoan;
  using FutureAndRequestId = agnocast::FutureAndRequestId<Future>;
  using SharedFutureAndRequestId = agnocast::FutureAndRequestId<SharedFuture>;

  BasicClient(std::shared_ptr<UntypedClient> untyped, Kind kind) noexcept
      : ClientBase(std::move(untyped)),
        Lender<typename Kind::Request, typename Kind::RequestCode>(
            this->untyped().requests().lender(), kind.request_code()),
        kind_(kind) {}

  /// Lends a request to fill. See Publisher::borrow_loaned_message.
  Request borrow_loaned_request() { return kind_.request_loan(this->lend()); }

  /// Sends a loan of this client; every copy of it becomes empty. The thread that runs the node's
  /// callbacks makes the future ready: when the first response arrives, or when no server is left
  /// that could respond. Never waits. On failure `request` is unchanged. Errors: no_server (no
  /// server is connected: wait_for_service()), would_block (a server has as many unread requests
  /// of this client as the depth allows), loan_invalid, and those of PublishResult.
  [[nodiscard]] Result<FutureAndRequestId> try_async_send_request(Request&& request) {
    const LoanPause pause;  // the bookkeeping of a request is private memory
    auto promise = std::make_shared<Promise>();
    Future future = promise->get_future();
    const Result<std::int64_t> sent = send(std::move(request), fulfil(promise));
    if (!sent) return tl::unexpected<Failure>(sent.error());
    return FutureAndRequestId(std::move(future), *sent);
  }
  /// The same with a callback: it receives the shared future when that is ready, where the node's
  /// callbacks run. If this function returns an error, the callback is never called.
  template <class Callback,
            class = std::enable_if_t<std::is_invocable_v<std::decay_t<Callback>&, SharedFuture>>>
  [[nodiscard]] Result<SharedFutureAndRequestId> try_async_send_request(Request&& request,
                                                                        Callback&& callback) {
    const LoanPause pause;
    auto promise = std::make_shared<Promise>();
    SharedFuture future = promise->get_future().share();
    const Result<std::int64_t> sent =
        send(std::move(request),
             [fulfil = fulfil(promise), future, function = std::forward<Callback>(callback)](
                 Block* response, Errc why) mutable {
               fulfil(response, why);
               function(future);
             });
    if (!sent) return tl::unexpected<Failure>(sent.error());
    return SharedFutureAndRequestId(std::move(future), *sent);
  }
  /// The same; throws Error.
  FutureAndRequestId async_send_request(Request&& request) {
    auto sent = try_async_send_request(std::move(request));
    if (!sent) detail::throw_error(sent.error());
    return std::move(*sent);
  }
  template <class Callback,
            class = std::enable_if_t<std::is_invocable_v<std::decay_t<Callback>&, SharedFuture>>>
  SharedFutureAndRequestId async_send_request(Request&& request, Callback&& callback) {
    auto sent = try_async_send_request(std::move(request), std::forward<Callback>(callback));
    if (!sent) detail::throw_error(sent.error());
    return std::move(*sent);
  }

 protected:
  const Kind& kind() const noexcept { return kind_; }

 private:
  auto fulfil(std::shared_ptr<Promise> promise) const {
    return [promise = std::move(promise), kind = kind_](Block* response, Errc why) {
      if (response == nullptr) {
        promise->set_exception(
            std::make_exception_ptr(Error(Failure{why, 0, "waiting for a response", 0})));
      } else {
        promise->set_value(kind.response(ipc_shared_ptr<const typename Kind::Response>(response)));
      }
    };
  }
  Result<std::int64_t> send(Request&& request, UntypedClient::Completion completion) {
    Result<RequestId> id = this->untyped().begin(std::move(completion));
    if (!id) return tl::unexpected<Failure>(id.error());
    bool has_failed = false;
    const PublishResult sent = this->take_back(
        std::move(Kind::handle(request)), [&](typename Kind::RequestCode::Owner&& message) {
          id_of(message.get()) = *id;
          const PublishResult result =
              commit(this->untyped().requests(), this->code(), std::move(message));
          has_failed = !result && this->untyped().remove(id->sequence);
          if (result || has_failed) return result;
          message.reset();  // cancelled meanwhile: its completion was already called
          return PublishResult{};
        });
    if (sent || (!has_failed && !this->untyped().remove(id->sequence))) return id->sequence;
    return fail(sent.code, "sending a request");
  }

  Kind kind_;
};

template <class Made, class Kind, class Node>
Result<std::shared_ptr<Made>> make_client(Node& node, const std::string& service, Kind kind,
                                          const QoS& qos, const GroupOf<Node>& group) {
  const Result<EndpointName> name = resolve_service(dereference(node), service);
  if (!name) return tl::unexpected<Failure>(name.error());
  const Result<ServiceTypes> types = kind.types();
  if (!types) return tl::unexpected<Failure>(types.error());
  auto adapted = AdapterOf<Node>::group(dereference(node), group);
  if (!adapted) return tl::unexpected<Failure>(adapted.error());
  auto untyped = UntypedClient::create(*name, *types, qos, kind.request_code().code(), *adapted,
                                       AdapterOf<Node>::is_over(dereference(node)));
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  return std::make_shared<Made>(std::move(*untyped), kind);
}

}  // namespace detail

AGNOCAST_CORE_BEGIN

/// A client of services of type ServiceT: any type with a Request and a Response that can be
/// messages (message_traits.hpp), such as example_interfaces::srv::AddTwoInts with
/// <agnocast/rosidl.hpp>.
template <class ServiceT>
class Client : public detail::BasicClient<detail::TypedService<ServiceT>> {
 public:
  using SharedPtr = std::shared_ptr<Client>;
  using detail::BasicClient<detail::TypedService<ServiceT>>::BasicClient;
};

/// Creates a client. Of `qos` only the depth is used: the limit for requests that a server has
/// not read yet, and for responses that this client has not read. Responses are taken in `group`
/// (null: the default group of the node): futures become ready only while it is spun. Errors: those
/// of try_create_publisher and try_create_subscription; invalid_argument (best effort, transient
/// local); invalid_name, also for a name of more than service_name_length_max bytes.
template <class ServiceT, class Node>
[[nodiscard]] Result<typename Client<ServiceT>::SharedPtr> try_create_client(
    Node&& node, const std::string& service, const QoS& qos = ServicesQoS(),
    const detail::GroupOf<Node>& group = nullptr) {
  return detail::make_client<Client<ServiceT>>(node, service, detail::TypedService<ServiceT>(), qos,
                                               group);
}
/// The same; throws Error.
template <class ServiceT, class Node>
typename Client<ServiceT>::SharedPtr create_client(Node&& node, const std::string& service,
                                                   const QoS& qos = ServicesQoS(),
                                                   const detail::GroupOf<Node>& group = nullptr) {
  auto client = try_create_client<ServiceT>(node, service, qos, group);
  if (!client) detail::throw_error(client.error());
  return std::move(*client);
}

AGNOCAST_CORE_END

}  // namespace agnocast
