// SPDX-License-Identifier: Apache-2.0
//
// EndpointEvents: what happened to one endpoint besides messages: matched, incompatible QoS,
// incompatible type, the state of the process's connection, heap collision, hold quota, missed
// deadlines, liveliness.
//
// The control thread counts, and takes count what they find. Status getters read in any thread; the
// node's executor runs the callbacks. Counts are cumulative, so an event is not missed if it comes
// before anyone waits for it (the daemon reports incompatibilities to a new endpoint at once).
// Getters and callbacks each remember which counts they have reported. The callbacks themselves are
// kept elsewhere: an endpoint may end in the control thread, which must not destroy user code.
#pragma once

#include <agnocast/events.hpp>
#include <base/clock.hpp>
#include <client/endpoint/qos_watch.hpp>
#include <client/process/wait_set.hpp>
#include <client/process/watch.hpp>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>

namespace agnocast {

class EndpointEvents {
 public:
  EndpointEvents() = default;
  EndpointEvents(const EndpointEvents&) = delete;
  EndpointEvents& operator=(const EndpointEvents&) = delete;

  // --- control thread

  void gained() noexcept;
  void ceased(bool was_alive = true) noexcept;
  void incompatible_qos(QosPolicyKind policy) noexcept;
  void incompatible_type() noexcept;
  void connection(const ConnectionInfo& info) noexcept;
  void heap_collision(const char* text) noexcept;
  /// Notes that messages wait because of the hold quota. Any thread.
  void quota_reached() noexcept;
  /// Notes that unread messages of a gone publisher were lost or had expired: a take found nothing
  /// to deliver. Any thread.
  void publisher_exhausted() noexcept;
  /// Wakes the watch after a move: matches in the newer session count from now on.
  void moved() noexcept;

  // --- any thread

  /// Once, before other threads use it.
  void begin_deadline(std::uint64_t period_ns) noexcept;
  bool has_deadline() const noexcept { return deadline_.next_ns() != never_ns; }
  bool has_lease() const noexcept {
    return next_lease_ns_.load(std::memory_order_relaxed) != never_ns;
  }
  /// When to look at the deadline and the leases next, if there are any.
  std::chrono::steady_clock::time_point look_due() const noexcept {
    const std::uint64_t next_ns =
        std::min(deadline_.next_ns(), next_lease_ns_.load(std::memory_order_relaxed));
    return std::chrono::steady_clock::time_point(
        std::chrono::nanoseconds(static_cast<std::int64_t>(next_ns)));
  }
  /// Counts missed deadlines. `newest_ns`: when the newest message was published; 0: unknown.
  void look_at_deadline(std::uint64_t newest_ns) noexcept;
  /// A matched publisher is alive again, or is not alive any more.
  void liveliness_changed(bool is_alive) noexcept;
  void liveliness_lost() noexcept;
  void look_at_leases_at(std::uint64_t next_ns) noexcept {
    next_lease_ns_.store(next_ns, std::memory_order_relaxed);
  }
  /// At this time, or earlier. Call it before the new lease can be seen by look_at_leases().
  void look_at_leases_by(std::uint64_t next_ns) noexcept {
    const std::lock_guard lock(leases_mutex_);
    new_lease_ns_ = std::min(new_lease_ns_, next_ns);
    if (next_ns < next_lease_ns_.load(std::memory_order_relaxed)) look_at_leases_at(next_ns);
  }
  /// Calls `look`, which looks at all leases and returns when to do so again. A lease that came
  /// meanwhile keeps its time.
  template <class Look>
  void look_at_leases(Look look) noexcept {
    const std::lock_guard one_at_a_time(looks_mutex_);
    {
      const std::lock_guard lock(leases_mutex_);
      new_lease_ns_ = never_ns;
    }
    const std::uint64_t next_ns = std::max(look(), monotonic_ns() + lease_look_interval_ns);
    const std::lock_guard lock(leases_mutex_);
    look_at_leases_at(std::min(next_ns, new_lease_ns_));
  }
  MatchedInfo matched_status() noexcept;
  IncompatibleQosInfo incompatible_qos_status() noexcept;
  IncompatibleTypeInfo incompatible_type_status() noexcept;
  HeapCollisionInfo heap_collision_status() noexcept;
  HoldQuotaInfo hold_quota_status() noexcept;
  DeadlineMissedInfo deadline_missed_status() noexcept;
  LivelinessLostInfo liveliness_lost_status() noexcept;
  LivelinessChangedInfo liveliness_changed_status() noexcept;
  /// From now on a change that has a callback wakes this wait set.
  void wake_for(const detail::EventCallbacks& callbacks,
                std::shared_ptr<WaitSet> wait_set) noexcept;
  /// From now on a change of an endpoint without callbacks wakes this wait set, which never ends:
  /// for loops that look at counts.
  static void wake_for_polling(const WaitSet& wait_set) noexcept {
    polling_.store(&wait_set, std::memory_order_release);
  }
  /// From now on a change of the matches notifies this watch.
  void tell(std::shared_ptr<Watch> watch) noexcept;

  // --- the executor of the node

  bool has_pending() const noexcept { return pending_.load(std::memory_order_acquire); }
  /// Runs at most one callback. Returns whether there was one. Throws what the callback throws.
  bool run_one(const detail::EventCallbacks& callbacks);

 private:
  // A lease may be another user's, and as short as that likes: no reason to look all the time.
  static constexpr std::uint64_t lease_look_interval_ns = 1'000'000;
  struct Counts {
    std::uint64_t matched = 0;  // total
    std::uint64_t ceased = 0;
    std::uint64_t qos = 0;
    std::uint64_t types = 0;
    std::uint64_t connections = 0;
    std::uint64_t collisions = 0;
    std::uint64_t quota_reached = 0;
    std::uint64_t deadlines = 0;
    std::uint64_t liveliness_lost = 0;
    std::int64_t alive = 0, not_alive = 0;  // now
    std::uint64_t publisher_exhausted = 0;
  };
  MatchedInfo matched_since(Counts& notified) const noexcept;
  IncompatibleQosInfo qos_since(Counts& notified) const noexcept;
  IncompatibleTypeInfo types_since(Counts& notified) const noexcept;
  HeapCollisionInfo collisions_since(Counts& notified) const noexcept;
  HoldQuotaInfo quota_reached_since(Counts& notified) const noexcept;
  DeadlineMissedInfo deadlines_since(Counts& notified) const noexcept;
  LivelinessLostInfo liveliness_lost_since(Counts& notified) const noexcept;
  LivelinessChangedInfo liveliness_since(Counts& notified) const noexcept;
  void changed() noexcept;
  bool matched_changed() const noexcept {
    return now_.matched != notified_by_callback_.matched ||
           now_.ceased != notified_by_callback_.ceased;
  }
  bool liveliness_has_changed() const noexcept {
    return now_.alive != notified_by_callback_.alive ||
           now_.not_alive != notified_by_callback_.not_alive;
  }
  bool look_for_pending() const noexcept;

  mutable std::mutex mutex_;
  Counts now_, notified_by_status_, notified_by_callback_;
  QosPolicyKind last_policy_ = QosPolicyKind::invalid;
  ConnectionInfo connection_;
  HeapCollisionInfo last_collision_;
  DeadlineWatch deadline_;
  std::atomic<std::uint64_t> next_lease_ns_{never_ns};
  std::mutex looks_mutex_;                 // taken first
  std::mutex leases_mutex_;                // taken last
  std::uint64_t new_lease_ns_ = never_ns;  // of leases since the last look began
  std::atomic<bool> pending_{false};
  struct {
    bool matched = false, qos = false, types = false, connections = false, collisions = false,
         quota_reached = false, deadlines = false, liveliness_lost = false,
         liveliness_changed = false, publisher_exhausted = false;
  } wanted_;
  std::shared_ptr<WaitSet> wait_set_;  // null: no callbacks
  std::shared_ptr<Watch> watch_;
  inline static constinit std::atomic<const WaitSet*> polling_{nullptr};
};

}  // namespace agnocast
