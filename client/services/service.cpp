// SPDX-License-Identifier: Apache-2.0
//
// The untyped half of Service: a subscription to requests, and a publisher of responses for each
// client, from the time its requests are linked until it has gone.
//
// A client is identified by one number, the persistent endpoint id of its publisher of requests;
// its responses go to a topic with that number. A library thread creates and ends these
// publishers: creation is a request to the daemon, and clients must find the service ready even
// if nothing runs the node's callbacks. A publisher announces its id only once it can be found
// here. So a client that sees the service ready can be answered, and an answering thread never
// waits for the library thread.

#include <agnocast/heap.hpp>
#include <agnocast/service.hpp>
#include <agnocast/service_name.hpp>
#include <base/signals.hpp>
#include <client/connection/connection.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/library_thread.hpp>
#include <client/process/watch.hpp>
#include <client/session/context.hpp>

#include <pthread.h>

#include <algorithm>
#include <map>
#include <mutex>
#include <new>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::detail {

class ServiceCore {
 public:
  ServiceCore(const EndpointName& service, const MessageType& response, const QoS& qos,
              const MessageCode& code, UntypedService::Callback callback)
      : service_(service),
        response_(response),
        qos_(qos),
        code_(code),
        callback_(std::make_shared<UntypedService::Callback>(std::move(callback))) {}

  const EndpointName& service() const noexcept { return service_; }
  LenderId lender() const noexcept { return lender_; }

  void begin(std::shared_ptr<UntypedSubscription> requests) noexcept {
    const std::lock_guard lock(mutex_);
    requests_ = std::move(requests);
  }
  std::shared_ptr<UntypedSubscription> requests() const noexcept {
    if (is_forked_child()) return nullptr;
    const std::lock_guard lock(mutex_);
    return requests_;
  }
  /// Returns the user's callback; null when the service has ended. The caller keeps it alive
  /// while it runs.
  std::shared_ptr<UntypedService::Callback> callback() const noexcept {
    const std::lock_guard lock(mutex_);
    return callback_;
  }
  /// Ends callbacks and answers, and destroys the callback: if called from inside it, when it
  /// returns. The core or the subscription may live on for a moment (in the library's thread, an
  /// executor), but holds no objects of the user any more.
  void end() noexcept {
    if (is_forked_child()) return;  // the lock may belong to the parent
    // One time limit for all endpoints together.
    const auto end = Watch::Clock::now() + Connection::answer_timeout;
    std::shared_ptr<UntypedSubscription> requests;
    {
      const std::lock_guard lock(mutex_);
      requests.swap(requests_);
    }
    if (requests != nullptr) requests->end(end);  // a running callback may still answer
    // Destroyed after unlocking.
    std::map<std::uint64_t, std::shared_ptr<UntypedPublisher>> publishers;
    std::shared_ptr<UntypedService::Callback> callback;
    const std::lock_guard lock(mutex_);
    publishers.swap(publishers_);
    callback.swap(callback_);
    refusals_.clear();
    for (const auto& [client, publisher] : publishers) publisher->end_by(end);
  }

  /// Makes publishers for the connected clients, and ends all others. Returns false if it must
  /// run again soon.
  bool meet_clients() {
    const auto requests = this->requests();
    if (requests == nullptr) return true;
    bool is_complete = true;
    std::vector<std::uint64_t> present, missing;
    for (const UntypedSubscription::Writer& writer : requests->writers()) {
      if (writer.is_gone) continue;
      if (writer.persistent_id == 0) is_complete = false;
      present.push_back(writer.persistent_id);
    }
    const auto is_gone = [&](const auto& entry) {
      return std::find(present.begin(), present.end(), entry.first) == present.end();
    };
    std::vector<std::shared_ptr<UntypedPublisher>> gone;  // ended after unlocking
    {
      const std::lock_guard lock(mutex_);
      for (auto at = publishers_.begin(); at != publishers_.end();) {
        if (!is_gone(*at)) {
          ++at;
        } else {
          // Ends without waiting; a thread that still has one may be about to answer.
          at->second->end_by(Watch::Clock::time_point::min());
          gone.push_back(std::move(at->second));
          at = publishers_.erase(at);
        }
      }
      std::erase_if(refusals_, is_gone);
      for (const std::uint64_t client : present) {
        if (client != 0 && publishers_.count(client) == 0) missing.push_back(client);
      }
    }
    gone.clear();
    for (const std::uint64_t client : missing) is_complete = meet(client, *requests) && is_complete;
    return is_complete;
  }

  Result<std::shared_ptr<UntypedPublisher>> publisher_to(std::uint64_t client) const noexcept {
    if (is_forked_child()) return fail(Errc::shut_down, "answering a request");
    std::shared_ptr<UntypedSubscription> requests;
    {
      const std::lock_guard lock(mutex_);
      if (const auto found = publishers_.find(client); found != publishers_.end())
        return found->second;
      if (const auto refused = refusals_.find(client); refused != refusals_.end())
        return tl::unexpected<Failure>(refused->second);
      requests = requests_;
    }
    return fail(requests != nullptr && is_there(client, *requests) ? Errc::would_block
                                                                   : Errc::endpoint_gone,
                "answering a request");
  }
  std::size_t refused_client_count() const noexcept {
    if (is_forked_child()) return 0;
    const std::lock_guard lock(mutex_);
    return refusals_.size();
  }
  Failure last_refusal() const noexcept {
    if (is_forked_child()) return {Errc::ok};
    const std::lock_guard lock(mutex_);
    return last_refusal_;
  }
  std::size_t client_count() const noexcept {
    if (is_forked_child()) return 0;
    const std::lock_guard lock(mutex_);
    return publishers_.size();
  }

  std::atomic<std::uint64_t> undelivered{0};

 private:
  bool meet(std::uint64_t client, const UntypedSubscription& requests) {
    const ActingFor creator(signals_);
    const auto made = UntypedPublisher::create({reply_topic(service_.topic, client), service_.node,
                                                requests.persistent_id(), true, service_.domain},
                                               response_, qos_, {}, code_);
    {
      const std::lock_guard lock(mutex_);
      if (requests_ == nullptr) {  // the service has ended meanwhile
        if (made) (*made)->end_by(Watch::Clock::time_point::min());
        return true;
      }
      if (!made) {
        last_refusal_ = made.error();
        refusals_.insert_or_assign(client, made.error());
        return false;
      }
      refusals_.erase(client);
      publishers_.emplace(client, *made);
    }
    (*made)->announce_persistent_id();
    return true;
  }
  static bool is_there(std::uint64_t client, const UntypedSubscription& requests) noexcept {
    const LoanPause pause;
    try {
      const auto writers = requests.writers();
      return std::any_of(writers.begin(), writers.end(), [&](const auto& writer) {
        return writer.persistent_id == client && !writer.is_gone;
      });
    } catch (const std::bad_alloc&) {
      return true;  // unknown: the caller tries again
    }
  }

  const LenderId lender_;
  const EndpointName service_;
  const MessageType response_;
  const QoS qos_;
  const MessageCode code_;
  const SignalMask signals_;
  mutable std::mutex mutex_;
  std::shared_ptr<UntypedSubscription> requests_;                          // null before and after
  std::map<std::uint64_t, std::shared_ptr<UntypedPublisher>> publishers_;  // by client
  std::map<std::uint64_t, Failure> refusals_;                              // by client
  Failure last_refusal_{Errc::ok};
  std::shared_ptr<UntypedService::Callback> callback_;
};

namespace {

/// One thread for all services of the process.
class Receptionist {
 public:
  static Receptionist& instance() {
    static Receptionist* const only = new Receptionist;  // immortal, like the context
    return *only;
  }
  const std::shared_ptr<Watch>& watch() const noexcept { return watch_; }

  Result<void> add(std::weak_ptr<ServiceCore> service) {
    const std::lock_guard lock(mutex_);
    if (!has_thread_) {
      try {
        const SignalsBlocked blocked;
        std::thread thread([this] {
          const LibraryThread registered(
              [](void* watch) noexcept { static_cast<Watch*>(watch)->notify(); }, watch_.get());
          serve();
        });
        ::pthread_setname_np(thread.native_handle(), "agnocast-srv");
        thread.detach();
      } catch (const std::system_error& refused) {
        return fail(Errc::os_failure, "starting the thread of services", refused.code().value());
      }
      has_thread_ = true;
    }
    services_.push_back(std::move(service));
    return {};
  }

 private:
  // Intervals until a client has announced its number, or after the daemon has refused a
  // publisher.
  static constexpr std::chrono::milliseconds look_first{1}, look_last{1000};

  void serve() {
    for (auto look = look_first; !LibraryThread::is_over();) {
      const std::uint64_t seen = watch_->count();
      const bool is_complete = meet_clients();
      look = is_complete ? look_first : std::min(look * 2, look_last);
      watch_->wait_beyond(
          seen, is_complete ? Watch::Clock::time_point::max() : Watch::Clock::now() + look);
    }
  }
  bool meet_clients() noexcept {
    try {
      bool is_complete = true;
      for (const auto& service : services()) is_complete = service->meet_clients() && is_complete;
      return is_complete;
    } catch (const std::bad_alloc&) {
      return false;
    }
  }
  std::vector<std::shared_ptr<ServiceCore>> services() {
    std::vector<std::shared_ptr<ServiceCore>> all;
    const std::lock_guard lock(mutex_);
    for (auto at = services_.begin(); at != services_.end();) {
      auto service = at->lock();
      if (service == nullptr) {
        at = services_.erase(at);
      } else {
        all.push_back(std::move(service));
        ++at;
      }
    }
    return all;
  }

  const std::shared_ptr<Watch> watch_ = std::make_shared<Watch>();
  std::mutex mutex_;
  std::vector<std::weak_ptr<ServiceCore>> services_;
  bool has_thread_ = false;
};

/// Makes the block of a request point to what is behind its header.
void pass_header(Block& block) noexcept {
  auto* const start = static_cast<std::byte*>(block.message.load(std::memory_order_relaxed));
  block.message.store(start + sizeof(RequestId), std::memory_order_relaxed);
}

}  // namespace

ServiceTypes make_service_types(const MessageType& request, const MessageType& response) noexcept {
  // Makes each half different from the same half of other services.
  const auto hash = [&](std::uint64_t half) {
    return LayoutHash()
        .add(std::string_view("service 1"))
        .add(half)
        .add(request.layout_hash())
        .add(response.name())
        .add(response.layout_hash())
        .value();
  };
  return {request.behind_header(sizeof(RequestId), hash(0)),
          response.behind_header(sizeof(RequestId), hash(1))};
}

Result<QoS> service_qos(const QoS& qos) {
  if (qos.is_transient_local() || !(qos.is_reliable() || qos.is_best_available()))
    return fail(Errc::invalid_argument, "a service is reliable and volatile");
  return QoS(qos.depth()).keep_all(qos.depth());
}

Result<std::shared_ptr<UntypedService>> UntypedService::create(
    const EndpointName& service, const ServiceTypes& types, const QoS& qos,
    const MessageCode& response, Callback callback, const CallbackGroup::SharedPtr& group) {
  const Result<QoS> keeps_all = service_qos(qos);
  if (!keeps_all) return tl::unexpected<Failure>(keeps_all.error());
  const Result<bool> off = is_switched_off();
  if (!off) return tl::unexpected<Failure>(off.error());
  if (!*off) {
    if (Result<void> ready = prepare_to_publish(types.response, response); !ready)
      return tl::unexpected<Failure>(ready.error());
  }
  auto core = std::make_shared<ServiceCore>(service, types.response, *keeps_all, response,
                                            std::move(callback));
  UntypedSubscription::Callback on_request;
  if (core->callback() != nullptr && *core->callback() != nullptr) {
    on_request = [core](Block* block) {
      pass_header(*block);
      const auto user = core->callback();
      if (user == nullptr) {
        const ipc_shared_ptr<const std::byte> unanswered(block);
      } else {
        (*user)(core, block);
      }
    };
  }
  auto requests = UntypedSubscription::create(
      {request_topic(service.topic), service.node, 0, false, service.domain}, types.request,
      *keeps_all, SubscriptionOptions().callback_group(group), std::move(on_request));
  if (!requests) return tl::unexpected<Failure>(requests.error());
  std::shared_ptr<UntypedService> made(new UntypedService(core));
  Receptionist& receptionist = Receptionist::instance();
  (*requests)->tell(receptionist.watch());
  core->begin(std::move(*requests));
  if (*off) return made;
  if (Result<void> added = receptionist.add(core); !added)
    return tl::unexpected<Failure>(added.error());
  receptionist.watch()->notify();
  return made;
}

UntypedService::~UntypedService() { core_->end(); }

Block* UntypedService::take() noexcept {
  const auto requests = core_->requests();
  Block* const block = requests != nullptr ? requests->take() : nullptr;
  if (block != nullptr) pass_header(*block);
  return block;
}
bool UntypedService::has_unread() const noexcept {
  const auto requests = core_->requests();
  return requests != nullptr && requests->has_unread();
}

Arrivals UntypedService::arrivals() noexcept {
  const auto requests = core_->requests();
  return requests != nullptr ? requests->arrivals() : Arrivals{};
}

LenderId UntypedService::lender_of(const ServiceCore& core) noexcept { return core.lender(); }

const std::string& UntypedService::service() const noexcept { return core_->service().topic; }
std::size_t UntypedService::client_count() const noexcept { return core_->client_count(); }
std::uint64_t UntypedService::undelivered_count() const noexcept {
  return core_->undelivered.load(std::memory_order_relaxed);
}
std::uint64_t UntypedService::callback_exception_count() const noexcept {
  const auto requests = core_->requests();
  return requests != nullptr ? requests->callback_exception_count() : 0;
}
bool UntypedService::is_active() const noexcept {
  const auto requests = core_->requests();
  return requests != nullptr && requests->is_active();
}
std::size_t UntypedService::refused_client_count() const noexcept {
  return core_->refused_client_count();
}
Failure UntypedService::last_refusal() const noexcept { return core_->last_refusal(); }
Result<std::shared_ptr<UntypedPublisher>> UntypedService::publisher_to(
    ServiceCore& core, std::uint64_t client) noexcept {
  return core.publisher_to(client);
}
void UntypedService::count_undelivered(ServiceCore& core) noexcept {
  core.undelivered.fetch_add(1, std::memory_order_relaxed);
}

}  // namespace agnocast::detail
