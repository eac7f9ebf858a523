// SPDX-License-Identifier: Apache-2.0
//
// EndpointEvents: what happened to one endpoint besides messages: matched, incompatible QoS,
// incompatible type, the state of the process's connection, heap collision, hold quota.
//
// The control thread counts, and takes count what they find. Status getters read in any thread; the
// node's executor runs the callbacks. Counts are cumulative, so an event is not missed if it comes
// before anyone waits for it (the daemon reports incompatibilities to a new endpoint at once).
// Getters and callbacks each remember which counts they have reported. The callbacks themselves are
// kept elsewhere: an endpoint may end in the control thread, which must not destroy user code.
#pragma once

#include <agnocast/events.hpp>
#include <client/process/wait_set.hpp>
#include <client/process/watch.hpp>

#include <atomic>
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
  void ceased() noexcept;
  void incompatible_qos(QosPolicyKind policy) noexcept;
  void incompatible_type() noexcept;
  void connection(const ConnectionInfo& info) noexcept;
  void heap_collision(const char* text) noexcept;
  /// Notes that messages wait because of the hold quota. Any thread.
  void quota_reached() noexcept;
  /// Notes that unread messages of a gone publisher were lost: a take found nothing to deliver. Any
  /// thread.
  void drained() noexcept;
  /// Wakes the watch after a move: matches in the newer session count from now on.
  void moved() noexcept;

  // --- any thread

  MatchedInfo matched_status() noexcept;
  IncompatibleQosInfo incompatible_qos_status() noexcept;
  IncompatibleTypeInfo incompatible_type_status() noexcept;
  HeapCollisionInfo heap_collision_status() noexcept;
  HoldQuotaInfo hold_quota_status() noexcept;
  /// From now on a change that has a callback wakes this wait set.
  void wake_for(const detail::EventCallbacks& callbacks,
                std::shared_ptr<WaitSet> wait_set) noexcept;
  /// From now on a change of the matches notifies this watch.
  void tell(std::shared_ptr<Watch> watch) noexcept;

  // --- the executor of the node

  bool has_pending() const noexcept { return pending_.load(std::memory_order_acquire); }
  /// Runs at most one callback. Returns whether there was one. Throws what the callback throws.
  bool run_one(const detail::EventCallbacks& callbacks);

 private:
  struct Counts {
    std::uint64_t matched = 0;  // total
    std::uint64_t ceased = 0;
    std::uint64_t qos = 0;
    std::uint64_t types = 0;
    std::uint64_t connections = 0;
    std::uint64_t collisions = 0;
    std::uint64_t quota_reached = 0;
    std::uint64_t drained = 0;
  };
  MatchedInfo matched_since(Counts& notified) const noexcept;
  IncompatibleQosInfo qos_since(Counts& notified) const noexcept;
  IncompatibleTypeInfo types_since(Counts& notified) const noexcept;
  HeapCollisionInfo collisions_since(Counts& notified) const noexcept;
  HoldQuotaInfo quota_reached_since(Counts& notified) const noexcept;
  void changed() noexcept;
  bool matched_changed() const noexcept {
    return now_.matched != notified_by_callback_.matched ||
           now_.ceased != notified_by_callback_.ceased;
  }
  bool look_for_pending() const noexcept;

  mutable std::mutex mutex_;
  Counts now_, notified_by_status_, notified_by_callback_;
  QosPolicyKind last_policy_ = QosPolicyKind::invalid;
  ConnectionInfo connection_;
  HeapCollisionInfo last_collision_;
  std::atomic<bool> pending_{false};
  struct {
    bool matched = false, qos = false, types = false, connections = false, collisions = false,
         quota_reached = false, drained = false;
  } wanted_;
  std::shared_ptr<WaitSet> wait_set_;
  std::shared_ptr<Watch> watch_;
};

}  // namespace agnocast
