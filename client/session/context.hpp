// SPDX-License-Identifier: Apache-2.0
//
// Context: one session of this process, with the operations that create and destroy endpoints. The
// first endpoint makes it. It is never destroyed (messages in statics stay valid), and is dead in a
// forked child.
//
// Usually there is one. When the daemon's store was lost, a second one begins beside it and becomes
// the current one (reregistration.hpp). The previous one goes on until nothing of it is in use, and
// then unmaps everything. The phases of a session: SessionState.
//
//   part             what it has                                          who uses it
//   Registration     the connection, the arena, board and own region      all threads
//   Creations        requests to the daemon for new endpoints             user threads
//   WaitSetPlaces    sleep words and doorbells, two mutexes               all threads
//   EndpointTable    publishers and subscriptions, a mutex                all threads
//   Departures       endpoints that leave, and their waiters, a mutex     all threads
//   OwnHeap          the heap and its windows, a mutex                    all threads
//   PeerTable        the mapped processes                                 control thread
//   ControlThread    packets of the daemon, and periodic work             control thread
//
// User threads reach shared memory directly, and the daemon only to create and destroy endpoints.
// The parts own their mutexes; Context has one, so that only one thread joins.
#pragma once

#include <agnocast/connection_state.hpp>
#include <agnocast/residency.hpp>
#include <agnocast/result.hpp>
#include <client/connection/connection.hpp>
#include <client/connection/reconnection.hpp>
#include <client/connection/registration.hpp>
#include <client/endpoint/endpoint_owner.hpp>
#include <client/endpoint/endpoint_table.hpp>
#include <client/endpoint/peer_table.hpp>
#include <client/endpoint/publisher_endpoint.hpp>
#include <client/endpoint/subscription_endpoint.hpp>
#include <client/heap/heap.hpp>
#include <client/process/wait_set.hpp>
#include <client/session/control_thread.hpp>
#include <client/session/creations.hpp>
#include <client/session/endpoint_request.hpp>
#include <client/session/session_state.hpp>
#include <client/session/wait_set_places.hpp>
#include <client/upkeep/departures.hpp>
#include <client/upkeep/own_heap.hpp>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>

namespace agnocast {

/// Returns whether AGNOCAST=off is set: endpoints then do nothing, without daemon and hook. Errors:
/// invalid_argument: the value is neither on nor off.
[[nodiscard]] Result<bool> is_switched_off() noexcept;

class Context : public EndpointOwner {
 public:
  static constexpr Reconnection::Clock::time_point for_ever =
      Reconnection::Clock::time_point::max();

  /// Returns the session of a publisher's or subscription's endpoint.
  template <class Endpoint>
  static Context* of(const Endpoint& endpoint) noexcept {
    return static_cast<Context*>(endpoint.owner());
  }
  /// Returns the current session of this process. Any thread.
  static Context& instance() noexcept {
    Context* const present = present_.load(std::memory_order_acquire);
    return present != nullptr ? *present : first();
  }

  /// Each of the following connects first if necessary. Errors of all: daemon_not_running,
  /// layout_mismatch, store_damaged, arena_occupied, lock_limit, address_limit, permission_denied,
  /// access_denied, descriptors_withheld, quota_exceeded, limit_reached, shut_down (forked child,
  /// exit handlers), invalid_argument (ROS_DOMAIN_ID), os_failure, started_anew and revoked (an
  /// orphaned session), and those named below. While a new session begins they wait for it, as for
  /// a daemon that is away.

  /// Creates a publisher. Errors also: hook_missing, hook_ineffective, type_mismatch, invalid_name,
  /// depth_refused.
  [[nodiscard]] Result<std::shared_ptr<PublisherEndpoint>> create_publisher(
      const EndpointRequest& request, const detail::MessageEnd& end_message);
  /// Creates a subscription. Errors also: type_mismatch, invalid_name, depth_refused.
  [[nodiscard]] Result<std::shared_ptr<SubscriptionEndpoint>> create_subscription(
      const EndpointRequest& request, std::shared_ptr<WaitSet> wait_set);
  /// Connects and opens the heap, for a caller that lends messages before it creates its publisher.
  /// Errors also: hook_missing, hook_ineffective.
  [[nodiscard]] Result<void> prepare_to_publish(HeapUse use);
  /// Creates a wait set. At most wait_set_count_max at a time; an unused one is given out again.
  [[nodiscard]] Result<std::shared_ptr<WaitSet>> create_wait_set();
  /// Returns the process's wait set for polled subscriptions. It arms only while a MessageWait
  /// sleeps: else no publisher rings it.
  [[nodiscard]] Result<std::shared_ptr<WaitSet>> idle_wait_set();

  /// Sends a request for the graph; `on_answer` runs in the control thread with the answer or the
  /// refusal, across connections.
  [[nodiscard]] static Result<void> watch_graph(const abi::wire::WatchGraph& request,
                                                const Connection::OnLater& on_answer);

  /// Ends the publisher. Messages that are still read stay until they are released. Returns when
  /// the daemon knows; at once while the daemon is away; after `answer_timeout` while it does not
  /// answer; and at `end` at the latest.
  void destroy(const std::shared_ptr<PublisherEndpoint>& publisher,
               Reconnection::Clock::time_point end = for_ever) noexcept;
  /// Ends the subscription. Messages held stay valid. Returns as above.
  void destroy(const std::shared_ptr<SubscriptionEndpoint>& subscription,
               Reconnection::Clock::time_point end = for_ever) noexcept;

  /// Call before the heap is open. Errors: invalid_argument.
  [[nodiscard]] Result<void> set_heap_scope(HeapScope scope) noexcept;
  /// Returns null until the first publisher; the value then stays.
  const Heap* heap() const noexcept { return heap_.get(); }
  /// Returns how publish adopts foreign memory. Call only after a publisher was created.
  SharedHeap shared_heap() const noexcept { return heap_.opened().shared_heap(); }
  /// The heap is full: destroys the messages that no reader needs any more, of every publisher.
  /// Returns false if there were none. Call from user threads, without locks that a message
  /// destructor takes.
  bool has_more_room() noexcept;
  /// Returns how many heap windows the daemon of this previous session has announced. Readers in
  /// that session have these and no more.
  std::uint64_t announced_windows() const noexcept { return heap_.growth().window_count(); }
  /// Returns false in a forked child, and before the first endpoint.
  bool is_connected() const noexcept;
  ConnectionState state() const noexcept;
  Errc orphan_reason() const noexcept { return state_.reason(); }
  void wake_control() noexcept {
    if (registration_.wake() != nullptr) (*registration_.wake())();
  }

 private:
  friend class Reregistration;

  /// Ends a session that has not become the current one.
  struct Drop {
    void operator()(Context* context) const noexcept;
  };

  Context() = default;
  static Context& first() noexcept;
  /// Calls `work` with the current session, and again with the next one if the session is lost.
  template <class Work>
  static auto in_present(Work work) -> decltype(work(instance()));
  template <class Endpoint, class... More>
  void in_all_sessions(const std::shared_ptr<Endpoint>& endpoint, const More&... more);
  Result<void> open_heap_for(HeapUse use);
  Result<std::shared_ptr<PublisherEndpoint>> make_publisher(const EndpointRequest& request,
                                                            const detail::MessageEnd& end_message,
                                                            const Continued& continued);
  Result<std::shared_ptr<SubscriptionEndpoint>> make_subscription(
      const EndpointRequest& request, const std::shared_ptr<WaitSet>& wait_set,
      const Continued& continued);
  Result<void> make_place(WaitSet& wait_set);
  void let_leave(PublisherEndpoint& publisher,
                 Reconnection::Clock::time_point end = for_ever) noexcept;
  void let_leave(SubscriptionEndpoint& subscription,
                 Reconnection::Clock::time_point end = for_ever) noexcept;

  Result<void> connect();
  Result<void> become_known();
  Result<void> start_control_thread();
  Result<void> start_thread();
  void wait_for(const Departure& departure, Reconnection::Clock::time_point end) noexcept;

  static std::atomic<Context*> present_;

  SessionState state_;  // a forked child inherits it
  bool has_thread_ = false;
  mutable std::mutex connecting_;
  Registration registration_;
  WaitSetPlaces places_;  // ahead of the endpoints, whose wait sets give them back
  EndpointTable endpoints_;
  PeerTable peers_{endpoints_};
  OwnHeap heap_{peers_};
  Departures departures_{endpoints_};
  Creations creations_{this, registration_, endpoints_, departures_};
  ControlThread control_{
      {this, state_, registration_, places_, endpoints_, peers_, heap_, departures_}};
};

}  // namespace agnocast
