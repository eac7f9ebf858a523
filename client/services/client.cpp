// SPDX-License-Identifier: Apache-2.0
//
// The untyped half of Client: a publisher of requests, a subscription to the responses for this
// client alone, and the pending requests with the servers that may answer them.
//
// A server is identified by one number, the persistent endpoint id of its subscription to
// requests and of its publisher of responses to this client. It can serve the client if both are
// linked. A request remembers the servers that received it, and ends with an error when none of
// them is left and nothing of them is unread.

#include <agnocast/client.hpp>
#include <agnocast/service_name.hpp>
#include <client/connection/connection.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/watch.hpp>

#include <cxxabi.h>

#include <algorithm>
#include <atomic>
#include <exception>
#include <map>
#include <mutex>
#include <new>
#include <utility>

namespace agnocast::detail {
namespace {

// Intervals of polling for the number of a new server: it announces it at once, unless it is
// stopped at that moment.
constexpr std::chrono::milliseconds unnamed_look_first{1}, unnamed_look_last{100};
constexpr std::chrono::milliseconds over_look{100};  // nothing wakes a waiting client at its end

/// Both callbacks run in the client's group, one at a time: a server that ends while another
/// thread handles its last response must not count as one that gives no response.
class ReplyOptions : public SubscriptionOptions {
 public:
  ReplyOptions(const CallbackGroup::SharedPtr& group, std::function<void()> changed) {
    callback_group(group);
    is_serial_ = true;
    events_.matched = [changed](MatchedInfo&) { changed(); };
    events_.publisher_exhausted = std::move(changed);
  }
};

}  // namespace

class ClientCore {
 public:
  explicit ClientCore(const EndpointName& service) noexcept : service_(service) {}

  const EndpointName& service() const noexcept { return service_; }
  UntypedPublisher& requests() const noexcept { return *requests_; }
  const std::shared_ptr<Watch>& watch() const noexcept { return watch_; }
  std::uint64_t id() const noexcept { return requests_->persistent_id(); }
  void have(std::shared_ptr<UntypedPublisher> requests) noexcept {
    requests_ = std::move(requests);
    requests_->tell(watch_);
  }
  void have(const std::shared_ptr<UntypedSubscription>& replies) noexcept {
    const std::lock_guard lock(mutex_);
    replies_ = replies;
    replies->tell(watch_);
  }

  struct Servers {
    std::vector<std::uint64_t> ready;
    bool has_unnamed = false;
  };
  Servers servers() const {
    const auto replies = this->replies();
    return replies != nullptr ? servers_of(*replies) : Servers();
  }

  Result<RequestId> begin(UntypedClient::Completion completion) {
    if (const Errc state = requests_->state(); state != Errc::ok)
      return fail(state, "sending a request");
    const auto replies = this->replies();
    const LoanPause pause;
    // give_up() takes the lock as well: it runs before this look, or finds the request.
    const std::lock_guard lock(mutex_);
    Servers now = replies != nullptr ? servers_of(*replies) : Servers();
    if (now.ready.empty()) return fail_with(Errc::no_server, service_.topic);
    const RequestId request{id(), ++last_};
    pending_.emplace(request.sequence,
                     Pending{std::move(completion), std::move(now.ready), SystemClock::now()});
    return request;
  }

  void on_response(Block* block) {
    std::exception_ptr thrown;
    complete(block, thrown);
    // The last response of a dead server is an event as well.
    give_up(thrown);
    if (thrown) std::rethrow_exception(thrown);
  }
  /// Completes the request that this answers.
  void complete(Block* block, std::exception_ptr& thrown) {
    auto* const start = static_cast<std::byte*>(block->message.load(std::memory_order_relaxed));
    const RequestId answered = *reinterpret_cast<const RequestId*>(start);
    block->message.store(start + sizeof(RequestId), std::memory_order_relaxed);
    const ipc_shared_ptr<const std::byte> response(block);
    UntypedClient::Completion completion;
    {
      const std::lock_guard lock(mutex_);
      const auto found =
          answered.client == id() ? pending_.find(answered.sequence) : pending_.end();
      if (found == pending_.end()) {
        ++dropped_;
      } else {
        completion = std::move(found->second.completion);
        pending_.erase(found);
      }
    }
    if (!completion) return;
    block->users.fetch_add(1, std::memory_order_relaxed);
    run(completion, block, Errc::ok, thrown);
  }
  /// Prevents further completions.
  void end() noexcept { is_ended_ = true; }
  /// Called when a server has come or gone, or the unread messages of a dead one are lost.
  void on_change() {
    std::exception_ptr thrown;
    on_change(thrown);
  }
  void on_change(std::exception_ptr& thrown) {
    give_up(thrown);
    if (thrown) std::rethrow_exception(thrown);
  }

  bool remove(std::int64_t request) noexcept {
    if (is_forked_child()) return false;
    UntypedClient::Completion gone;  // user code: destroyed after unlocking; likewise below
    const std::lock_guard lock(mutex_);
    const auto found = pending_.find(request);
    if (found == pending_.end()) return false;
    gone = std::move(found->second.completion);
    pending_.erase(found);
    return true;
  }
  std::size_t prune() noexcept {
    if (is_forked_child()) return 0;
    std::map<std::int64_t, Pending> gone;
    const std::lock_guard lock(mutex_);
    gone.swap(pending_);
    return gone.size();
  }
  std::size_t prune_older_than(std::chrono::system_clock::time_point time,
                               std::vector<std::int64_t>* pruned) {
    if (is_forked_child()) return 0;
    const LoanPause pause;
    std::vector<Pending> gone;
    const std::lock_guard lock(mutex_);
    for (auto at = pending_.begin(); at != pending_.end();) {
      if (at->second.sent >= time) {
        ++at;
        continue;
      }
      if (pruned != nullptr) pruned->push_back(at->first);
      gone.push_back(std::move(at->second));
      at = pending_.erase(at);
    }
    return gone.size();
  }
  std::size_t pending_count() const noexcept {
    if (is_forked_child()) return 0;
    const std::lock_guard lock(mutex_);
    return pending_.size();
  }
  std::uint64_t dropped_count() const noexcept {
    if (is_forked_child()) return 0;
    const std::lock_guard lock(mutex_);
    return dropped_;
  }

 private:
  using SystemClock = std::chrono::system_clock;
  struct Pending {
    UntypedClient::Completion completion;
    std::vector<std::uint64_t> servers;
    SystemClock::time_point sent;
  };

  std::shared_ptr<UntypedSubscription> replies() const noexcept {
    if (is_forked_child()) return nullptr;
    const std::lock_guard lock(mutex_);
    return replies_.lock();
  }

  Servers servers_of(const UntypedSubscription& replies) const {
    Servers found;
    const std::vector<std::uint64_t> readers = requests_->reader_persistent_ids();
    for (const UntypedSubscription::Writer& writer : replies.writers()) {
      found.has_unnamed = found.has_unnamed || writer.persistent_id == 0;
      if (!writer.is_gone && writer.persistent_id != 0 &&
          std::binary_search(readers.begin(), readers.end(), writer.persistent_id))
        found.ready.push_back(writer.persistent_id);
    }
    return found;
  }

  /// Removes the requests that no server can answer any more; all of them, or none if there is no
  /// memory.
  std::map<std::int64_t, Pending> take_unanswerable() {
    const LoanPause pause;
    std::map<std::int64_t, Pending> gone;
    const auto replies = this->replies();
    if (replies == nullptr) return gone;
    const std::lock_guard lock(mutex_);
    if (pending_.empty()) return gone;
    const std::vector<UntypedSubscription::Writer> there = replies->writers();
    const auto may_answer = [&](std::uint64_t server) {
      return std::any_of(there.begin(), there.end(),
                         [&](const auto& writer) { return writer.persistent_id == server; });
    };
    for (auto at = pending_.begin(); at != pending_.end();) {
      const auto& servers = at->second.servers;
      const auto request = at++;
      if (std::none_of(servers.begin(), servers.end(), may_answer))
        gone.insert(pending_.extract(request));
    }
    return gone;
  }

  /// Cancelled requests not completed yet: they become pending again if this thread ends before.
  struct GivenUp {
    ClientCore& client;
    std::map<std::int64_t, Pending> requests;
    ~GivenUp() {
      if (requests.empty() || is_forked_child()) return;
      {
        const std::lock_guard lock(client.mutex_);
        client.pending_.merge(requests);
      }
      if (const auto replies = client.replies()) replies->look_again();
    }
  };

  /// Completes unanswerable requests. A completion may end the client, or the thread.
  void give_up(std::exception_ptr& thrown) {
    try {
      GivenUp gone{*this, take_unanswerable()};
      while (!gone.requests.empty()) {
        const auto next = gone.requests.extract(gone.requests.begin());
        if (!is_ended_) run(next.mapped().completion, nullptr, Errc::no_server, thrown);
      }
    } catch (const std::bad_alloc&) {
      if (!thrown) thrown = std::current_exception();
    }
  }
  /// Calls a completion and records the first exception, so that all are called.
  static void run(const UntypedClient::Completion& completion, Block* response, Errc why,
                  std::exception_ptr& thrown) {
    try {
      completion(response, why);
    } catch (const ::abi::__forced_unwind&) {
      throw;  // pthread_exit()
    } catch (...) {
      if (!thrown) thrown = std::current_exception();
    }
  }

  const EndpointName service_;
  const std::shared_ptr<Watch> watch_ = std::make_shared<Watch>();
  std::shared_ptr<UntypedPublisher> requests_;
  mutable std::mutex mutex_;
  std::weak_ptr<UntypedSubscription> replies_;
  std::map<std::int64_t, Pending> pending_;
  std::int64_t last_ = 0;
  std::uint64_t dropped_ = 0;
  std::atomic<bool> is_ended_{false};
};

Result<std::shared_ptr<UntypedClient>> UntypedClient::create(const EndpointName& service,
                                                             const ServiceTypes& types,
                                                             const QoS& qos,
                                                             const MessageCode& request,
                                                             const CallbackGroup::SharedPtr& group,
                                                             std::function<bool()> is_over) {
  return make(service, types, qos, request, std::move(is_over), &group);
}
Result<std::shared_ptr<UntypedClient>> UntypedClient::create_polled(const EndpointName& service,
                                                                    const ServiceTypes& types,
                                                                    const QoS& qos,
                                                                    const MessageCode& request) {
  return make(service, types, qos, request, {}, nullptr);
}

// `group`: null for a polled one.
Result<std::shared_ptr<UntypedClient>> UntypedClient::make(const EndpointName& service,
                                                           const ServiceTypes& types,
                                                           const QoS& qos,
                                                           const MessageCode& request,
                                                           std::function<bool()> is_over,
                                                           const CallbackGroup::SharedPtr* group) {
  const Result<QoS> keeps_all = service_qos(qos);
  if (!keeps_all) return tl::unexpected<Failure>(keeps_all.error());
  auto core = std::make_shared<ClientCore>(service);
  EndpointName name{request_topic(service.topic), service.node};
  name.domain = service.domain;
  auto requests = UntypedPublisher::create(name, types.request, *keeps_all, {}, request);
  if (!requests) return tl::unexpected<Failure>(requests.error());
  core->have(std::move(*requests));
  name.topic = reply_topic(service.topic, core->id());
  const std::weak_ptr<ClientCore> weak = core;
  const auto on_change = [weak] {
    if (const auto client = weak.lock()) client->on_change();
  };
  auto replies = group != nullptr
                     ? UntypedSubscription::create(
                           name, types.response, *keeps_all, ReplyOptions(*group, on_change),
                           [core](Block* block) { core->on_response(block); })
                     : UntypedSubscription::create(name, types.response, *keeps_all, {}, nullptr);
  if (!replies) return tl::unexpected<Failure>(replies.error());
  core->have(*replies);
  std::shared_ptr<UntypedClient> client(new UntypedClient(std::move(core), std::move(is_over)));
  client->replies_ = std::move(*replies);
  return client;
}

void UntypedClient::poll() {
  // Anybody who may publish there can send responses without end, which answer nothing.
  constexpr int responses_max = 64;
  std::exception_ptr thrown;
  for (int i = 0; i < responses_max; ++i) {
    Block* const block = replies_->take();
    if (block == nullptr) break;
    core_->complete(block, thrown);
  }
  core_->on_change(thrown);
}

UntypedClient::~UntypedClient() {
  const auto end = Watch::Clock::now() + Connection::answer_timeout;  // for both
  core_->end();
  replies_->end(end);  // waits for a running callback, unless it is this one
  requests().end_by(end);
  (void)core_->prune();
}

UntypedPublisher& UntypedClient::requests() const noexcept { return core_->requests(); }
Result<RequestId> UntypedClient::begin(Completion completion) {
  return core_->begin(std::move(completion));
}
bool UntypedClient::remove(std::int64_t request) noexcept { return core_->remove(request); }
std::size_t UntypedClient::prune() noexcept { return core_->prune(); }
std::size_t UntypedClient::prune_older_than(std::chrono::system_clock::time_point time,
                                            std::vector<std::int64_t>* pruned) {
  return core_->prune_older_than(time, pruned);
}
std::size_t UntypedClient::server_count() const { return core_->servers().ready.size(); }

bool UntypedClient::wait(std::chrono::nanoseconds timeout) const {
  const auto end = Watch::Clock::now() + timeout;
  for (auto pause = unnamed_look_first; is_active() && is_served();
       pause = std::min(pause * 2, unnamed_look_last)) {
    const std::uint64_t seen = core_->watch()->count();
    const ClientCore::Servers servers = core_->servers();
    if (!servers.ready.empty()) return true;
    const auto now = Watch::Clock::now();
    if (now >= end || (is_over_ && is_over_())) return false;
    Watch::Clock::time_point look = end;
    if (servers.has_unnamed) look = std::min<Watch::Clock::time_point>(look, now + pause);
    if (is_over_) look = std::min<Watch::Clock::time_point>(look, now + over_look);
    core_->watch()->wait_beyond(seen, look);
  }
  return false;
}

const std::string& UntypedClient::service() const noexcept { return core_->service().topic; }
std::size_t UntypedClient::pending_count() const noexcept { return core_->pending_count(); }
std::uint64_t UntypedClient::dropped_count() const noexcept { return core_->dropped_count(); }
bool UntypedClient::is_active() const noexcept { return core_->requests().is_active(); }

}  // namespace agnocast::detail
