// SPDX-License-Identifier: Apache-2.0
//
// Services and clients whose type is found at run time by its ROS name, like the publishers and
// subscriptions of generic.hpp: for bridges and tools. Requests and responses are GenericMessage
// and GenericLoan; everything else is as in service.hpp and client.hpp. Generic and typed sides
// match.
#pragma once

#include <agnocast/client.hpp>
#include <agnocast/generic.hpp>
#include <agnocast/service.hpp>

#include <cstddef>
#include <memory>
#include <new>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {

/// A service type found by its name. Cheap to copy, valid as long as the process lives.
struct IntrospectedServiceType {
  IntrospectedType request, response;
};

/// Finds the service type with this ROS name: "example_interfaces/srv/AddTwoInts", short
/// "example_interfaces/AddTwoInts". Searches like try_find_message_type(), with the same errors.
[[nodiscard]] inline Result<IntrospectedServiceType> try_find_service_type(
    const std::string& name, const std::vector<std::string>& paths = {}) {
  std::string full = name;
  const std::size_t slash = full.find('/');
  if (slash != full.npos && slash == full.rfind('/')) full.insert(slash, "/srv");
  const auto request = try_find_message_type(full + "_Request", paths);
  if (!request) return tl::unexpected<Failure>(request.error());
  const auto response = try_find_message_type(full + "_Response", paths);
  if (!response) return tl::unexpected<Failure>(response.error());
  return IntrospectedServiceType{*request, *response};
}
/// The same; throws Error.
inline IntrospectedServiceType find_service_type(const std::string& name,
                                                 const std::vector<std::string>& paths = {}) {
  const auto found = try_find_service_type(name, paths);
  if (!found) detail::throw_error(found.error());
  return *found;
}

namespace detail {

/// As ServiceMessageCode.
struct ServiceMessageCodeByTable {
  struct End {
    const RosMembers* members = nullptr;
    void operator()(std::byte* body) const noexcept {
      members->fini_function(body);
      ::operator delete(&id_of(body));
    }
  };
  using Owner = std::unique_ptr<std::byte, End>;
  static constexpr bool copy_may_throw = true;
  const RosMembers* members;

  Owner make(rosidl_runtime_cpp::MessageInitialization how =
                 rosidl_runtime_cpp::MessageInitialization::ALL) const {
    const auto free = [](void* memory) { ::operator delete(memory); };
    std::unique_ptr<void, decltype(free)> memory(::operator new(bytes()), free);
    auto* const body = static_cast<std::byte*>(memory.get()) + sizeof(RequestId);
    new (memory.get()) RequestId();
    members->init_function(body, how);
    (void)memory.release();
    return own(body);
  }
  Owner copy(const std::byte& original) const {
    Owner made = make(rosidl_runtime_cpp::MessageInitialization::SKIP);
    id_of(made.get()) = id_of(const_cast<std::byte*>(&original));
    copy_by_table(*members, &original, made.get());
    return made;
  }
  Owner own(std::byte* body) const noexcept { return Owner(body, End{members}); }
  void* start_of(std::byte* body) const noexcept { return &id_of(body); }
  std::size_t bytes() const noexcept { return sizeof(RequestId) + members->size_of_; }
  MessageCode code() const noexcept {
    return {{[](const void* table, void* start) noexcept {
               End{static_cast<const RosMembers*>(table)}(static_cast<std::byte*>(start) +
                                                          sizeof(RequestId));
             },
             members},
            false};
  }
};

/// As TypedService.
struct GenericServiceKind {
  using Request = std::byte;
  using Response = std::byte;
  using RequestCode = ServiceMessageCodeByTable;
  using ResponseCode = ServiceMessageCodeByTable;
  using RequestLoan = GenericLoan;
  using ResponseLoan = GenericLoan;
  using RequestMessage = GenericMessage;
  using WritableRequestMessage = GenericMessage;
  using ResponseMessage = GenericMessage;
  const RosMembers* request_members;
  const RosMembers* response_members;

  explicit GenericServiceKind(const IntrospectedServiceType& type) noexcept
      : request_members(&type.request.members()), response_members(&type.response.members()) {}
  RequestCode request_code() const noexcept { return {request_members}; }
  ResponseCode response_code() const noexcept { return {response_members}; }
  GenericLoan request_loan(ipc_shared_ptr<std::byte> loan) const noexcept {
    return {std::move(loan), request_members};
  }
  GenericLoan response_loan(ipc_shared_ptr<std::byte> loan) const noexcept {
    return {std::move(loan), response_members};
  }
  GenericMessage request(ipc_shared_ptr<const std::byte> message) const noexcept {
    return {std::move(message), request_members};
  }
  GenericMessage response(ipc_shared_ptr<const std::byte> message) const noexcept {
    return {std::move(message), response_members};
  }
  static ipc_shared_ptr<std::byte>& handle(GenericLoan& loan) noexcept { return loan.handle(); }
  static const ipc_shared_ptr<std::byte>& handle(const GenericLoan& loan) noexcept {
    return loan.handle();
  }
  Result<ServiceTypes> types() const noexcept {
    const Result<MessageType> request = IntrospectedType(*request_members).message_type();
    if (!request) return tl::unexpected<Failure>(request.error());
    const Result<MessageType> response = IntrospectedType(*response_members).message_type();
    if (!response) return tl::unexpected<Failure>(response.error());
    return make_service_types(*request, *response);
  }
};

}  // namespace detail

/// As ServiceRequest.
using GenericServiceRequest = detail::BasicServiceRequest<detail::GenericServiceKind>;

/// A Service of a type found at run time.
class GenericService : public detail::BasicService<detail::GenericServiceKind> {
 public:
  using SharedPtr = std::shared_ptr<GenericService>;
  using BasicService::BasicService;
};

/// A Client of a type found at run time.
class GenericClient : public detail::BasicClient<detail::GenericServiceKind> {
 public:
  using SharedPtr = std::shared_ptr<GenericClient>;
  using BasicClient::BasicClient;
};

/// Creates a service of a type found at run time. `callback` takes a GenericMessage and a
/// GenericLoan&, which is sent when the callback returns, or a GenericServiceRequest to answer
/// later. Errors as of try_create_service.
template <class Node, class Callback>
[[nodiscard]] Result<GenericService::SharedPtr> try_create_generic_service(
    Node&& node, const std::string& service, const IntrospectedServiceType& type,
    Callback&& callback, const QoS& qos = ServicesQoS(),
    const detail::GroupOf<Node>& group = nullptr) {
  return detail::make_service<GenericService>(node, service, detail::GenericServiceKind(type),
                                              std::forward<Callback>(callback), qos, group);
}
/// Finds the type by its name; errors also those of try_find_service_type.
template <class Node, class Callback>
[[nodiscard]] Result<GenericService::SharedPtr> try_create_generic_service(
    Node&& node, const std::string& service, const std::string& type, Callback&& callback,
    const QoS& qos = ServicesQoS(), const detail::GroupOf<Node>& group = nullptr) {
  const auto found = try_find_service_type(type);
  if (!found) return tl::unexpected<Failure>(found.error());
  return try_create_generic_service(node, service, *found, std::forward<Callback>(callback), qos,
                                    group);
}

/// Creates a client of a type found at run time. Errors as of try_create_client.
template <class Node>
[[nodiscard]] Result<GenericClient::SharedPtr> try_create_generic_client(
    Node&& node, const std::string& service, const IntrospectedServiceType& type,
    const QoS& qos = ServicesQoS(), const detail::GroupOf<Node>& group = nullptr) {
  return detail::make_client<GenericClient>(node, service, detail::GenericServiceKind(type), qos,
                                            group);
}
/// Finds the type by its name; errors also those of try_find_service_type.
template <class Node>
[[nodiscard]] Result<GenericClient::SharedPtr> try_create_generic_client(
    Node&& node, const std::string& service, const std::string& type,
    const QoS& qos = ServicesQoS(), const detail::GroupOf<Node>& group = nullptr) {
  const auto found = try_find_service_type(type);
  if (!found) return tl::unexpected<Failure>(found.error());
  return try_create_generic_client(node, service, *found, qos, group);
}

/// The same; these throw Error. `type`: a name, or an IntrospectedServiceType.
template <class Node, class Type, class Callback>
GenericService::SharedPtr create_generic_service(Node&& node, const std::string& service,
                                                 const Type& type, Callback&& callback,
                                                 const QoS& qos = ServicesQoS(),
                                                 const detail::GroupOf<Node>& group = nullptr) {
  auto made =
      try_create_generic_service(node, service, type, std::forward<Callback>(callback), qos, group);
  if (!made) detail::throw_error(made.error());
  return std::move(*made);
}
template <class Node, class Type>
GenericClient::SharedPtr create_generic_client(Node&& node, const std::string& service,
                                               const Type& type, const QoS& qos = ServicesQoS(),
                                               const detail::GroupOf<Node>& group = nullptr) {
  auto made = try_create_generic_client(node, service, type, qos, group);
  if (!made) detail::throw_error(made.error());
  return std::move(*made);
}

}  // namespace agnocast
