// SPDX-License-Identifier: Apache-2.0
//
// ServiceRoutes: carries out the plans of service_plan.hpp, and moves requests and responses, in
// the form of rmw_cyclonedds: before the body are the client's id and its request's number, which
// the server returns.
//
//   served   a request from DDS is kept until a client here can send it; that client's callback
//            writes the response under the id and number of the request
//   asked    a service here gets a request and writes it under an id of the bridge's own and the
//            next number; the response with that id and number is its answer
//
// A request without a server in time is dropped and counted, as it would be lost on a network. Its
// client decides how long to wait, so while a server takes requests, others wait for their turn.
// Nothing signals room: kept requests are tried again at intervals (retry_interval.hpp). Everything
// except callbacks is run()'s thread.
#pragma once

#include <agnocast/agnocast.hpp>
#include <agnocast/generic_service.hpp>
#include <bridge/common/linger.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/refusals.hpp>
#include <bridge/common/slow_deleter.hpp>
#include <bridge/common/traffic.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/dds/ros_graph.hpp>
#include <bridge/plan/service_plan.hpp>
#include <bridge/services/pending_requests.hpp>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

namespace agnocast::bridge {

/// A service type, ready for both directions.
struct BridgedService {
  std::shared_ptr<const BridgedType> request, response;

  IntrospectedServiceType introspected() const {
    return {request->introspected, response->introspected};
  }
};

/// One route, since its creation. Any thread.
struct ServiceTraffic {
  using Counter = std::atomic<std::uint64_t>;
  Counter requests{0}, request_bytes{0}, responses{0}, response_bytes{0};
  Counter malformed{0}, refused{0}, timed_out{0}, forgotten{0}, unasked{0};  // see ServiceNumbers
  Counter last_ns{0};
  const std::uint64_t since_ns = monotonic_ns();
  Seldom reports;  // limits log lines

  void count_request(std::size_t size) noexcept { count(requests, request_bytes, size); }
  void count_response(std::size_t size) noexcept { count(responses, response_bytes, size); }
  ServiceNumbers numbers() const noexcept {
    return {requests,  request_bytes, responses, response_bytes, malformed, refused,
            timed_out, forgotten,     unasked,   since_ns,       last_ns};
  }

 private:
  void count(Counter& messages, Counter& bytes, std::size_t size) noexcept {
    ++messages;
    bytes += size;
    last_ns = monotonic_ns();
  }
};

class ServiceRoutes {
 public:
  /// All must outlive it; `deleter` ends writers, `types` knows the halves of every planned type.
  ServiceRoutes(DdsParticipant& participant, Node& node, const MessageTypes& types, const Log& log,
                SlowDeleter& deleter, Refusals& refusals)
      : participant_(participant),
        node_(node),
        types_(types),
        log_(log),
        deleter_(deleter),
        refusals_(refusals) {}

  /// Returns daemon_not_running if the rest of the plan has to be retried later.
  [[nodiscard]] Errc apply(const ServicePlan& plan);
  /// Takes samples from those readers that are its own.
  void move(std::span<DdsReader* const> ready);
  /// Sends kept requests when due. Returns when to call it again; nothing if none is kept.
  std::optional<Time> send_kept(Time now);
  /// Adds endpoints in DDS to the nodes of this host that they serve.
  void tell(const NodesByName& nodes) const;
  /// Returns the current state of all routes.
  std::vector<BridgeStatus::ServiceNow> look() const;

  std::size_t size() const noexcept { return served_.size() + asked_.size(); }

 private:
  struct Raw {
    std::vector<std::byte> bytes;
  };
  struct Kept {
    std::shared_ptr<Raw> request;
    Guid writer;
    Time end;
  };
  /// The part that callbacks use; it outlives the route as long as they do.
  struct Answering {
    BridgedService type;
    std::unique_ptr<DdsWriter> responses;
    ServiceTraffic traffic;
    std::string service;
  };
  /// A request that the server had no room for, ready to be sent.
  struct Decoded {
    std::shared_ptr<const Raw> request;
    ServiceHeader header;
    GenericLoan loan;
  };
  struct Served {
    ServiceRoute plan;
    std::shared_ptr<Answering> answering;
    std::unique_ptr<DdsReader> requests;
    GenericClient::SharedPtr client;
    std::deque<Kept> kept;
    std::size_t kept_bytes = 0;
    std::map<Guid, std::size_t> kept_of;  // messages, by participant
    // The readers for responses of clients in DDS, by participant and USER_DATA, as of this version
    // of the remotes.
    std::multimap<std::pair<Guid, std::string>, std::uint64_t> ways_back;
    std::uint64_t ways_back_at = 0;
    std::optional<Decoded> next;  // one of kept
    bool has_room = true;         // at the last attempt
    Time next_look;
    std::chrono::nanoseconds interval{0};
    PendingRequests pending;
  };
  struct Asking {
    BridgedService type;
    std::unique_ptr<DdsWriter> requests;
    std::uint64_t client_id = 0;
    ServiceTraffic traffic;
    std::string service;
    std::mutex mutex;  // guards the rest
    std::int64_t newest = 0;
    struct Pending {
      GenericServiceRequest request;
      std::set<Guid> servers;  // that may have received it
    };
    std::set<Guid> servers;  // in DDS now
    std::map<std::int64_t, Pending> pending;
  };
  struct Asked {
    ServiceRoute plan;
    std::shared_ptr<Asking> asking;
    std::unique_ptr<DdsReader> responses;
    GenericService::SharedPtr service;
  };
  struct Ends {
    std::unique_ptr<DdsReader> reader;
    std::unique_ptr<DdsWriter> writer;
    Guid id;
  };

  DdsResult<Ends> make_ends(const ServiceKey& key, ServiceRole role);
  void serve(const ServiceKey& key, const ServiceRoute& route, const BridgedService& type);
  void ask(const ServiceKey& key, const ServiceRoute& route, const BridgedService& type);
  void refuse(const std::string& what, const Failure& why);
  void keep_requests(const ServiceKey& key);
  void take_responses(Asked& asked);
  /// Returns whether a request was sent.
  bool look_at_kept(Served& served, Time now);
  enum class Sent : std::uint8_t { sent, dropped, no_server, no_room };
  Sent send_on(Served& served, const Kept& kept, Time now);
  void answer(Asked& asked, const Raw& response);
  /// Returns whether a response reaches a client: its reader is one of `matched`.
  bool can_be_answered(Served& served, const Remote& client,
                       std::span<const std::uint64_t> matched) const;
  /// Keeps a request; returns false, and counts it, if there is no room.
  bool keep(Served& served, std::shared_ptr<Raw> request, const Guid& writer);
  /// Drops the newest request of the client with most, for a client with less; returns false if
  /// there is none.
  bool make_place(Served& served, const Guid& client);
  void forget(Served& served, const Kept& kept);
  /// Returns whether a request waits for servers that are all gone.
  static bool is_in_vain(Asking& asking, const std::set<Guid>& servers);
  static void write_request(const Log& log, Asking& asking, const GenericServiceRequest& request);
  static void dropped(const Log& log, ServiceTraffic& traffic, ServiceTraffic::Counter& reason,
                      const std::string& service, const std::string& why);

  DdsParticipant& participant_;
  Node& node_;
  const MessageTypes& types_;
  const Log& log_;
  SlowDeleter& deleter_;
  Refusals& refusals_;
  std::map<ServiceKey, Served> served_;
  std::map<ServiceKey, Asked> asked_;
  std::set<ServiceKey> keeping_;  // those of served_ that keep requests
  std::size_t kept_bytes_ = 0;    // of all of them; at most held_bytes_max, as for topics
  std::unordered_map<const DdsReader*, ServiceKey> served_by_, asked_by_;
  std::uint32_t ids_ = 0;
  Errc refusal_ = Errc::ok;  // agnocastd's last refusal in this apply()
};

}  // namespace agnocast::bridge
