// SPDX-License-Identifier: Apache-2.0
//
// Reregistration: what this process does when the daemon's store was lost. docs/decisions/0006.
//
//   the current session is orphaned, its daemon will not come back
//     → hello to the new daemon, regions, the heap's windows are brought along  → a new present one
//     → places of wait sets → subscriptions → publishers, each beside its former self
//     → each publisher moves when its subscriptions are there, or after a while
//   meanwhile the previous session goes on among those who are in it, and ends by itself
//
// A thread of its own does it, because it waits for answers; it ends when everything has moved.
// User threads never wait for it, but for creations, which wait as for a daemon that is away.
#pragma once

#include <agnocast/result.hpp>
#include <client/session/context.hpp>

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace agnocast {

class Reregistration {
 public:
  using Clock = std::chrono::steady_clock;
  // A publisher waits so long for the subscriptions that it had. A process that has not said hello
  // by then is stopped, or was refused; the others have waited long enough for nothing newer.
  static constexpr std::chrono::seconds move_patience{5};
  // Between two attempts to begin: twice as long each time.
  static constexpr std::chrono::milliseconds pause_first{20}, pause_last{30'000};

  static constexpr std::chrono::milliseconds pause_without_memory{100};

  /// Of this process; immortal.
  static Reregistration& instance() noexcept;

  // --- what there is to move. Forgotten when nobody has it any more.

  void add(const std::shared_ptr<PublisherEndpoint>& publisher, const EndpointRequest& request,
           const detail::MessageEnd& end_message);
  void add(const std::shared_ptr<SubscriptionEndpoint>& subscription,
           const EndpointRequest& request);
  void add(const std::shared_ptr<WaitSet>& wait_set);
  /// All of this process.
  std::vector<std::shared_ptr<WaitSet>> wait_sets();

  /// The current session is lost. Any thread; nothing happens when it is known.
  void begin() noexcept;
  /// The same where no thread is at it: one may have been refused.
  void go_on() noexcept;
  /// Waits until `lost` is not the current session any more; false at the deadline, or when there
  /// will be no other.
  bool wait_for_next(const Context& lost, Clock::time_point deadline);
  /// No wait set uses a place of this session any more.
  void release_places(const Context& former) noexcept;

 private:
  struct Request {
    explicit Request(const EndpointRequest& request);
    EndpointRequest get() const;
    std::string topic, type, node;
    EndpointRequest rest;
  };
  struct Publisher {
    std::weak_ptr<PublisherEndpoint> endpoint;
    Request request;
    detail::MessageEnd end_message;
  };
  struct Subscription {
    std::weak_ptr<SubscriptionEndpoint> endpoint;
    Request request;
  };
  /// A publisher whose successor is there and gets nothing yet.
  struct Pending {
    std::shared_ptr<PublisherEndpoint> publisher, successor;
    Clock::time_point since;
  };

  void start() noexcept;  // under the mutex
  void run() noexcept;
  void run_once();
  Result<void> begin_next(Context& former);
  void move_everything(Context& present);
  template <class Which>
  void abandon_pending(Which which) noexcept;
  Result<void> make_places(Context& present);
  Result<void> make_subscriptions(Context& present);
  Result<void> make_publishers(Context& present);
  static bool try_to_move(Context& present, const Pending& pending);
  void check_added(const Context* context) noexcept;
  void pause(std::chrono::milliseconds duration);

  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<Publisher> publishers_;
  std::vector<Subscription> subscriptions_;
  std::vector<std::weak_ptr<WaitSet>> wait_sets_;
  bool is_running_ = false, is_wanted_ = false;
  bool is_refused_ = false;                        // nobody waits for it
  bool is_hopeless_ = false;                       // nor tries
  std::chrono::milliseconds pause_ = pause_first;  // of the thread, as the next
  std::vector<Pending> pending_;
};

}  // namespace agnocast
