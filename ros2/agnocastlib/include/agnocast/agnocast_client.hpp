// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocastlib/endpoints.hpp>
#include <agnocastlib/failure_log.hpp>

#include <rclcpp/rclcpp.hpp>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <exception>
#include <future>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

namespace agnocast {

/// A client of services of type ServiceT. Any thread may call any function.
template <class ServiceT>
class Client {
  using Core = core::Client<ServiceT>;

 public:
  using SharedPtr = std::shared_ptr<Client>;
  using RequestT = typename ServiceT::Request;
  using ResponseT = typename ServiceT::Response;
  using Future = typename Core::Future;
  using SharedFuture = typename Core::SharedFuture;
  using FutureAndRequestId = typename Core::FutureAndRequestId;
  using SharedFutureAndRequestId = typename Core::SharedFutureAndRequestId;

  /// Throws Error.
  template <class NodeT>
  Client(NodeT* node, const std::string& service_name, const rclcpp::QoS& qos,
         rclcpp::CallbackGroup::SharedPtr group)
      : core_(make(node, service_name, qos, std::move(group))),
        failures_(std::make_shared<agnocastlib::FailureLog>(
            node->get_logger(), std::string("a request to '") + core_->get_service_name() + "'")) {}

  /// Lends a request to fill. See Publisher::borrow_loaned_message.
  ipc_shared_ptr<RequestT> borrow_loaned_request() { return core_->borrow_loaned_request(); }

  const char* get_service_name() const noexcept { return core_->get_service_name(); }
  bool service_is_ready() const { return core_->service_is_ready(); }
  /// Returns false when `timeout` is over (negative: no limit), after rclcpp::shutdown() unless one
  /// is ready, and in a forked child.
  template <class Rep = std::int64_t, class Period = std::nano>
  bool wait_for_service(
      std::chrono::duration<Rep, Period> timeout = std::chrono::duration<Rep, Period>(-1)) const {
    return core_->wait_for_service(timeout);
  }

  /// Sends a loan of this client. A failure, now or when the server ends without an answer, is
  /// logged, and the future throws it (Error). The request is dropped then.
  FutureAndRequestId async_send_request(ipc_shared_ptr<RequestT>&& request) {
    const LoanPause pause;
    auto promise = std::make_shared<typename Core::Promise>();
    Future future = promise->get_future();
    const std::int64_t id = send(
        std::move(request), *promise,
        [promise](const SharedFuture& answer) mutable { promise->set_value(answer.get()); },
        [promise](std::exception_ptr why) { promise->set_exception(why); });
    return FutureAndRequestId(std::move(future), id);
  }
  /// The same; `callback` is called with the response, where the callbacks of the group run, and
  /// not at all after a failure.
  template <class Callback,
            class = std::enable_if_t<std::is_invocable_v<std::decay_t<Callback>&, SharedFuture>>>
  SharedFutureAndRequestId async_send_request(ipc_shared_ptr<RequestT>&& request,
                                              Callback&& callback) {
    const LoanPause pause;
    auto promise = std::make_shared<typename Core::Promise>();
    SharedFuture future = promise->get_future().share();
    const std::int64_t id = send(
        std::move(request), *promise,
        [promise, future,
         function = std::forward<Callback>(callback)](const SharedFuture& answer) mutable {
          promise->set_value(answer.get());
          function(future);
        },
        [promise](std::exception_ptr why) { promise->set_exception(why); });
    return SharedFutureAndRequestId(std::move(future), id);
  }

 private:
  template <class NodeT>
  static typename Core::SharedPtr make(NodeT* node, const std::string& service,
                                       const rclcpp::QoS& qos,
                                       rclcpp::CallbackGroup::SharedPtr group) {
    agnocastlib::refuse_other_system();
    agnocastlib::keep_group(node->get_node_base_interface(), group);
    return core::create_client<ServiceT>(*node, service, qos, group);
  }

  /// Returns the number of the request; 0, and `promise` has the reason: it was not sent.
  template <class Answered, class Failed>
  std::int64_t send(ipc_shared_ptr<RequestT>&& request, typename Core::Promise& promise,
                    Answered answered, Failed failed) {
    ipc_shared_ptr<RequestT> loan = std::move(request);
    auto sent = core_->try_async_send_request(
        std::move(loan), [answered = std::move(answered), failed = std::move(failed),
                          failures = failures_](SharedFuture answer) mutable {
          try {
            (void)answer.get();
          } catch (const Error& error) {
            failures->report(error.failure());
            failed(std::current_exception());
            return;
          }
          answered(answer);
        });
    if (sent) return sent->request_id;
    loan.reset();
    failures_->report(sent.error());
    promise.set_exception(std::make_exception_ptr(Error(sent.error())));
    return 0;
  }

  const typename Core::SharedPtr core_;
  const std::shared_ptr<agnocastlib::FailureLog> failures_;
};

}  // namespace agnocast
