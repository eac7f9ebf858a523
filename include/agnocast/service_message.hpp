// SPDX-License-Identifier: Apache-2.0
//
// Requests and responses in shared memory: a header, then the message that users see. Also the
// common part of client.hpp and service.hpp.
#pragma once

#include <agnocast/message_type.hpp>
#include <agnocast/publisher.hpp>
#include <agnocast/shared_allocator.hpp>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <type_traits>
#include <utility>

namespace agnocast {

/// Identifies a request; precedes it and its response. Sixteen bytes, so that the message behind
/// is aligned.
struct alignas(16) RequestId {
  std::uint64_t client = 0;   ///< unique among the clients of a daemon's life
  std::int64_t sequence = 0;  ///< of its client; the first is 1
  friend bool operator==(const RequestId& a, const RequestId& b) noexcept {
    return a.client == b.client && a.sequence == b.sequence;
  }
  friend bool operator!=(const RequestId& a, const RequestId& b) noexcept { return !(a == b); }
};
static_assert(sizeof(RequestId) == 16);

/// rclcpp's default for services: reliable, volatile, depth 10.
class ServicesQoS : public QoS {
 public:
  ServicesQoS() noexcept : QoS(10) {}
};

namespace detail {

/// Returns the header of a message, which is identified by the address behind the header.
template <class Message>
RequestId& id_of(Message* message) noexcept {
  return *reinterpret_cast<RequestId*>(reinterpret_cast<std::byte*>(message) - sizeof(RequestId));
}

/// Both halves of a service, as message types of their topics.
struct ServiceTypes {
  MessageType request, response;
};
[[nodiscard]] AGNOCAST_PUBLIC ServiceTypes make_service_types(const MessageType& request,
                                                              const MessageType& response) noexcept;

struct NoBase {};
/// Allocates from the shared heap by itself if its body does.
template <class Body>
struct ServiceMessage
    : std::conditional_t<std::is_base_of_v<SharedMessage, Body>, SharedMessage, NoBase> {
  static_assert(alignof(Body) <= sizeof(RequestId),
                "agnocast: a request or response cannot be aligned to more than 16 bytes");
  ServiceMessage() = default;
  ServiceMessage(const RequestId& of, const Body& original) : id(of), body(original) {}
  RequestId id;
  Body body{};

  static ServiceMessage* around(Body* body) noexcept {
    return reinterpret_cast<ServiceMessage*>(&id_of(body));
  }
};

template <class Body>
struct ServiceMessageCode {
  struct End {
    void operator()(Body* body) const noexcept { delete ServiceMessage<Body>::around(body); }
  };
  using Owner = std::unique_ptr<Body, End>;
  static constexpr bool copy_may_throw = detail::copy_may_throw<Body>;
  Owner make() const { return Owner(&(new ServiceMessage<Body>())->body); }
  Owner copy(const Body& original) const {
    return Owner(&(new ServiceMessage<Body>(id_of(const_cast<Body*>(&original)), original))->body);
  }
  Owner own(Body* body) const noexcept { return Owner(body); }
  void* start_of(Body* body) const noexcept { return &id_of(body); }
  constexpr std::size_t bytes() const noexcept { return sizeof(RequestId) + sizeof(Body); }
  MessageCode code() const noexcept {
    return {MessageEnd::of<ServiceMessage<Body>>(), std::is_base_of_v<SharedMessage, Body>};
  }
};

/// A service type known at compile time, as users see it.
template <class ServiceT>
struct TypedService {
  using Request = typename ServiceT::Request;
  using Response = typename ServiceT::Response;
  using RequestCode = ServiceMessageCode<Request>;
  using ResponseCode = ServiceMessageCode<Response>;
  using RequestLoan = ipc_shared_ptr<Request>;
  using ResponseLoan = ipc_shared_ptr<Response>;
  using RequestMessage = ipc_shared_ptr<const Request>;
  using WritableRequestMessage = ipc_shared_ptr<Request>;  // usual in rclcpp; it is read-only
  using ResponseMessage = ipc_shared_ptr<const Response>;

  RequestCode request_code() const noexcept { return {}; }
  ResponseCode response_code() const noexcept { return {}; }
  RequestLoan request_loan(RequestLoan loan) const noexcept { return loan; }
  ResponseLoan response_loan(ResponseLoan loan) const noexcept { return loan; }
  RequestMessage request(RequestMessage message) const noexcept { return message; }
  ResponseMessage response(ResponseMessage message) const noexcept { return message; }
  template <class Loan>
  static Loan& handle(Loan& loan) noexcept {
    return loan;
  }
  Result<ServiceTypes> types() const noexcept {
    const Result<MessageType> request = message_type_of<Request>();
    if (!request) return tl::unexpected<Failure>(request.error());
    const Result<MessageType> response = message_type_of<Response>();
    if (!response) return tl::unexpected<Failure>(response.error());
    return make_service_types(*request, *response);
  }
};

/// Returns the QoS of a service's topics: reliable and volatile, nothing is overwritten, with the
/// depth of `qos`. Errors: invalid_argument.
[[nodiscard]] AGNOCAST_PUBLIC Result<QoS> service_qos(const QoS& qos);

}  // namespace detail
}  // namespace agnocast
