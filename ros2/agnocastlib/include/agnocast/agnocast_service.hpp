// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocastlib/endpoints.hpp>
#include <agnocastlib/failure_log.hpp>

#include <rclcpp/rclcpp.hpp>

#include <memory>
#include <string>
#include <type_traits>
#include <utility>

namespace agnocast {

/// A service of type ServiceT. Any thread may call any function.
template <class ServiceT>
class Service {
  using Kind = detail::TypedService<ServiceT>;

 public:
  using SharedPtr = std::shared_ptr<Service>;
  using RequestT = typename ServiceT::Request;
  using ResponseT = typename ServiceT::Response;

  /// `callback` takes a request, ipc_shared_ptr<const RequestT> or ipc_shared_ptr<RequestT>, whose
  /// memory is read-only, and a response to fill, ipc_shared_ptr<ResponseT>, by reference, rvalue
  /// or value. The response is sent when it returns; a failure is logged. Throws Error.
  template <class NodeT, class Func>
  Service(NodeT* node, const std::string& service_name, Func&& callback, const rclcpp::QoS& qos,
          rclcpp::CallbackGroup::SharedPtr group)
      : untyped_(make(node, service_name, std::forward<Func>(callback), qos, std::move(group))) {}

  const char* get_service_name() const noexcept { return untyped_->service().c_str(); }

 private:
  template <class Func, class Request>
  static constexpr bool takes = std::is_invocable_v<Func&, Request, ipc_shared_ptr<ResponseT>&> ||
                                std::is_invocable_v<Func&, Request, ipc_shared_ptr<ResponseT>&&>;

  template <class Func, class Request>
  static void call(Func& callback, Request&& request, ipc_shared_ptr<ResponseT>& response) {
    if constexpr (std::is_invocable_v<Func&, Request, ipc_shared_ptr<ResponseT>&>) {
      callback(std::forward<Request>(request), response);
    } else {
      // The callback may keep its handle, which is empty once the response is sent.
      ipc_shared_ptr<ResponseT> given = response;
      callback(std::forward<Request>(request), std::move(given));
    }
  }

  template <class NodeT, class Func>
  static std::shared_ptr<detail::UntypedService> make(NodeT* node, const std::string& service,
                                                      Func&& callback, const rclcpp::QoS& qos,
                                                      rclcpp::CallbackGroup::SharedPtr group) {
    using Function = std::decay_t<Func>;
    using Read = ipc_shared_ptr<const RequestT>;
    using Writable = ipc_shared_ptr<RequestT>;
    static_assert(
        takes<Function, Read> || takes<Function, Writable>,
        "agnocast: a service's callback takes agnocast::ipc_shared_ptr<const Request> (or "
        "of Request) and agnocast::ipc_shared_ptr<Response>, by reference or rvalue");
    agnocastlib::refuse_other_system();
    agnocastlib::keep_group(node->get_node_base_interface(), group);
    const auto name = detail::resolve_service(*node, service);
    if (!name) detail::throw_error(name.error());
    const Kind kind;
    const auto types = kind.types();
    if (!types) detail::throw_error(types.error());
    auto failures = std::make_shared<agnocastlib::FailureLog>(
        node->get_logger(), "a response of '" + name->topic + "'");
    const auto adapted = detail::AdapterOf<NodeT>::group(*node, group);
    if (!adapted) detail::throw_error(adapted.error());
    auto untyped = detail::UntypedService::create(
        *name, *types, qos, kind.response_code().code(),
        [function = Function(std::forward<Func>(callback)), failures = std::move(failures), kind](
            const std::shared_ptr<detail::ServiceCore>& core, detail::Block* block) mutable {
          using Request = std::conditional_t<takes<Function, Read>, Read, Writable>;
          const RequestId id = detail::id_of(static_cast<RequestT*>(block->message.load()));
          Request request(block);
          const detail::Responder<Kind> responder(core, kind);
          ipc_shared_ptr<ResponseT> response = responder.borrow();
          call(function, std::move(request), response);
          const PublishResult sent = responder.send(id, response);
          if (sent) return;
          detail::UntypedService::count_undelivered(*core);
          response.reset();
          failures->report(sent.code);
        },
        *adapted);
    if (!untyped) detail::throw_error(untyped.error());
    return std::move(*untyped);
  }

  std::shared_ptr<detail::UntypedService> untyped_;
};

}  // namespace agnocast
