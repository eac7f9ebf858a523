// SPDX-License-Identifier: Apache-2.0
//
// Reregistration: moves this process to a new session when the daemon's store was lost.
// docs/decisions/0006.
//
//   the current session is orphaned, its daemon will not come back
//     → hello to the new daemon, regions, the heap's windows are brought along → a new session
//     → places of wait sets → subscriptions → publishers, each beside its predecessor
//     → each publisher moves when its subscriptions are there, or after a while
//   meanwhile the previous session goes on among its processes, and ends by itself
//
// A thread of its own does it, because it waits for answers; it ends when everything has moved.
// Only creations in user threads wait for it, as for a daemon that is away.
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
  // How long a publisher waits for the subscriptions that it had. A process that has not said hello
  // by then is stopped, or was refused; the others must not wait longer for newer messages.
  static constexpr std::chrono::seconds move_patience{5};
  // Between two attempts to begin; doubles each time.
  static constexpr std::chrono::milliseconds pause_first{20}, pause_last{30'000};

  static constexpr std::chrono::milliseconds pause_without_memory{100};

  /// Returns the one of this process; immortal.
  static Reregistration& instance() noexcept;

  // --- what there is to move; entries whose endpoint has ended are removed

  void add(const std::shared_ptr<PublisherEndpoint>& publisher, const EndpointRequest& request,
           const detail::MessageEnd& end_message);
  void add(const std::shared_ptr<SubscriptionEndpoint>& subscription,
           const EndpointRequest& request);
  void add(const std::shared_ptr<WaitSet>& wait_set);
  /// Returns all wait sets of this process.
  std::vector<std::shared_ptr<WaitSet>> wait_sets();

  /// Starts the move after the current session was lost. Any thread; a repeated call does nothing.
  void begin() noexcept;
  /// Starts the move if no thread is at it: starting one may have failed before.
  void go_on() noexcept;
  /// Waits until `lost` is not the current session any more. Returns false at the deadline, or when
  /// there will be no other session.
  bool wait_for_next(const Context& lost, Clock::time_point deadline);
  /// Removes the places of the session from all wait sets.
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
  /// A publisher whose successor exists and gets no messages yet.
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
  bool is_refused_ = false;                        // so callers do not wait for it
  bool is_hopeless_ = false;                       // nor does the thread try again
  std::chrono::milliseconds pause_ = pause_first;  // of the thread: the next one
  std::vector<Pending> pending_;
};

}  // namespace agnocast
