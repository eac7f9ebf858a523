// SPDX-License-Identifier: Apache-2.0
//
// ServiceServer and ServiceClient: the services of an rmw. They take requests and responses when
// they are asked to, in the node's own layout, and match the services and clients of this library.
//
// rclcpp throws in a server when sending a response fails, and in a client when sending a request
// does. So what the other side makes impossible is no error here: it is counted.
#pragma once

#include <agnocast/generic_service.hpp>
#include <agnocast/result.hpp>
#include <ros2/rmw_agnocast_cpp/core/listener.hpp>
#include <ros2/rmw_agnocast_cpp/core/message_support.hpp>
#include <ros2/rmw_agnocast_cpp/core/own_endpoints.hpp>
#include <ros2/rmw_agnocast_cpp/core/topics.hpp>

#include <sys/types.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

namespace agnocast::rmw {

/// Both halves of a service.
struct ServiceSupport {
  MessageSupport request, response;
};

/// Any thread.
class ServiceServer final : public Listenable {
 public:
  /// Errors: as of create_service. Throws std::bad_alloc.
  [[nodiscard]] static Result<std::unique_ptr<ServiceServer>> create(const NodeName& node,
                                                                     const std::string& service,
                                                                     const ServiceSupport& support,
                                                                     const QoS& qos);

  bool is_ready() const noexcept override { return untyped_->has_unread(); }
  Arrivals arrivals() const noexcept override { return untyped_->arrivals(); }

  std::array<Listenable*, 1> listenables() noexcept { return {this}; }
  /// Takes the oldest request into the node's message. Returns false, and leaves it, if there is
  /// none. A request that leads out of its client's memory is dropped, as a message by
  /// TopicSubscription::take(). Throws std::bad_alloc.
  bool take(void* request, RequestId& id);
  /// Answers a request. Errors: type_refused (a member is longer than its type allows), those of
  /// this process in PublishResult. A client that has gone or does not read is none of them:
  /// undelivered_count(). Throws std::bad_alloc.
  [[nodiscard]] Result<void> send(const RequestId& id, const void* response);
  std::uint64_t undelivered_count() const noexcept {
    return undelivered_.load(std::memory_order_relaxed);
  }

 private:
  using Kind = agnocast::detail::GenericServiceKind;
  ServiceServer(const ServiceSupport& support,
                std::shared_ptr<agnocast::detail::UntypedService> untyped, const Kind& kind,
                const agnocast::detail::EndpointName& service)
      : support_(support),
        kind_(kind),
        untyped_(std::move(untyped)),
        responder_(untyped_->core(), kind),
        own_(service.domain, service.topic, Clock::now()) {}

  const ServiceSupport support_;
  const Kind kind_;
  const std::shared_ptr<agnocast::detail::UntypedService> untyped_;
  const agnocast::detail::Responder<Kind> responder_;
  const OwnEndpoint<Clock::time_point> own_;  // since when
  std::atomic<std::uint64_t> undelivered_{0};
};

/// Any thread.
class ServiceClient final : public Listenable {
 public:
  /// Requests that may wait for their responses. A server that lives need not answer, and rmw has
  /// no call that gives a request up: the bound keeps a client below 2 MiB.
  static constexpr std::size_t unanswered_max = 4096;

  /// A server of this process is usually matched when it returns, as over DDS; it waits 100 ms for
  /// that at most. Errors: as of create_client. Throws std::bad_alloc.
  [[nodiscard]] static Result<std::unique_ptr<ServiceClient>> create(const NodeName& node,
                                                                     const std::string& service,
                                                                     const ServiceSupport& support,
                                                                     const QoS& qos);

  bool is_ready() const noexcept override;
  Arrivals arrivals() const noexcept override;
  std::array<Listenable*, 2> listenables() noexcept { return {this, &server_arrival_}; }
  /// Returns how many servers get requests sent now, and can answer them.
  std::size_t server_count() const { return client_.get_server_count(); }
  /// Has one arrival while there is such a server: the graph shows a server before it is matched.
  Listenable& server_arrival() noexcept { return server_arrival_; }

  /// Sends a request and returns its number, from 1. Errors: type_refused (a member is longer than
  /// its type allows), those of this process in PublishResult. Without a server, or with one that
  /// does not read, it is dropped: dropped_count(). But where none is ready, and this process has
  /// one, that is waited for, within a second of its creation or the client's: DDS matches
  /// endpoints of a process at once. Where unanswered_max later ones wait for a response, the
  /// response to an earlier one is dropped. Throws std::bad_alloc.
  [[nodiscard]] Result<std::int64_t> send(const void* request);
  std::uint64_t dropped_count() const noexcept { return dropped_.load(std::memory_order_relaxed); }

  /// Takes the next response into the node's message. Returns false, and leaves it, if there is
  /// none. A response that leads out of its server's memory is dropped. Throws std::bad_alloc.
  bool take(void* response, std::int64_t& number);

 private:
  using Kind = agnocast::detail::GenericServiceKind;
  /// That of the library, asked by polling.
  class Client : public agnocast::detail::BasicClient<Kind> {
   public:
    using BasicClient::BasicClient;
    using ClientBase::untyped;
  };
  class ServerArrival final : public Listenable {
   public:
    explicit ServerArrival(const Client& client) noexcept : client_(client) {}
    bool is_ready() const noexcept override;
    Arrivals arrivals() const noexcept override {
      const std::uint64_t come = is_ready() ? 1 : 0;
      return {come, come};
    }

   private:
    const Client& client_;
  };
  struct Response {
    std::int64_t number;
    GenericMessage message;
  };
  /// The responses that have come; the completions of the library's client have it as well.
  struct Inbox {
    std::mutex mutex;
    std::deque<Response> responses;
  };
  ServiceClient(const ServiceSupport& support,
                std::shared_ptr<agnocast::detail::UntypedClient> untyped, const Kind& kind,
                OwnDomain domain)
      : support_(support), client_(std::move(untyped), kind), domain_(domain) {}

  void wait_for_own_server(std::chrono::milliseconds age) const;

  const ServiceSupport support_;
  Client client_;
  ServerArrival server_arrival_{client_};
  const OwnDomain domain_;
  const pid_t process_ = ::getpid();
  const Clock::time_point created_ = Clock::now();
  const std::shared_ptr<Inbox> inbox_ = std::make_shared<Inbox>();
  mutable std::mutex polling_;
  std::int64_t given_up_ = 0;  // no request up to this one is pending; under polling_
  std::atomic<std::int64_t> last_{0};
  std::atomic<std::uint64_t> dropped_{0};
};

}  // namespace agnocast::rmw
