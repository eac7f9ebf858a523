// SPDX-License-Identifier: Apache-2.0
//
// Events of an endpoint: matched endpoints, endpoints that could not match, messages held back, and
// the connection to the daemon. Each event is counted from the creation of the endpoint. A status
// getter returns the counts and their change since its last call; a callback (set in the endpoint's
// options) is called when they change. Event callbacks run where the message callbacks of the node
// run. They keep their own count of changes: a status getter does not take a change away from a
// callback.
#pragma once

#include <agnocast/connection_state.hpp>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <utility>

namespace agnocast {

/// Counts of a subscription's messages: see SubscriptionBase::get_arrivals().
struct Arrivals {
  std::uint64_t count = 0;
  std::uint64_t unread = 0;
};

/// Endpoints on the other side that are connected to this one. Fields as in rclcpp::MatchedInfo.
struct MatchedInfo {
  std::size_t total_count = 0;
  std::size_t total_count_change = 0;
  std::size_t current_count = 0;
  std::int32_t current_count_change = 0;
};

/// Numbers as in rmw_qos_policy_kind_t.
enum class QosPolicyKind : std::int32_t {
  invalid = 1 << 0,  ///< nothing was incompatible yet
  durability = 1 << 1,
  deadline = 1 << 2,
  liveliness = 1 << 3,
  reliability = 1 << 4,
  liveliness_lease_duration = 1 << 8,
};

/// Endpoints of the topic that request more than this one offers (or offer less than it
/// requests).
struct IncompatibleQosInfo {
  std::int32_t total_count = 0;
  std::int32_t total_count_change = 0;
  /// Policy of the newest one; of several the first of reliability, durability, deadline,
  /// liveliness and its lease.
  QosPolicyKind last_policy_kind = QosPolicyKind::invalid;
};
using QOSOfferedIncompatibleQoSInfo = IncompatibleQosInfo;
using QOSRequestedIncompatibleQoSInfo = IncompatibleQosInfo;

/// Attempts of other processes to use the topic with another type, or the same type with another
/// layout. The daemon refused them; each process is counted once.
struct IncompatibleTypeInfo {
  std::int32_t total_count = 0;
  std::int32_t total_count_change = 0;
};

/// Heap windows whose addresses are in use in a reader's process (by a JIT or a GPU driver, for
/// example). A publisher is notified of its readers, a subscription of its publishers. Messages
/// in such a window do not reach that reader; the text says whether the publisher continues in
/// another window.
struct HeapCollisionInfo {
  std::int32_t total_count = 0;
  std::int32_t total_count_change = 0;
  /// The newest case: the processes, the window, the consequence, the occupied range, and its
  /// content if the reader belongs to the same user. Ends with a NUL.
  char last_text[256] = "";
};

/// How often messages of a publisher began to wait because the subscription held as many of them as
/// it may (SubscriptionOptions::hold_quota). Counted once until it releases one.
struct HoldQuotaInfo {
  std::int32_t total_count = 0;
  std::int32_t total_count_change = 0;
};

/// Periods of the QoS deadline in which a publisher published nothing, or a subscription got
/// nothing of any publisher. They begin with the first message, and anew with each further one.
/// A getter looks, and an executor that spins: a period between two looks that a later message has
/// ended is not counted.
struct DeadlineMissedInfo {
  std::int32_t total_count = 0;
  std::int32_t total_count_change = 0;
};
using QOSDeadlineOfferedInfo = DeadlineMissedInfo;
using QOSDeadlineRequestedInfo = DeadlineMissedInfo;

/// How often a publisher was not alive any more: its liveliness is manual_by_topic, and it neither
/// published nor asserted its liveliness for the time of its lease. A getter looks, and an executor
/// that spins: what ended between two looks is not counted.
struct LivelinessLostInfo {
  std::int32_t total_count = 0;
  std::int32_t total_count_change = 0;
};
using QOSLivelinessLostInfo = LivelinessLostInfo;

/// Matched publishers of a subscription. One that has left or died does not count at all.
struct LivelinessChangedInfo {
  std::int32_t alive_count = 0;
  std::int32_t not_alive_count = 0;  ///< manual_by_topic, and silent for the time of their lease
  std::int32_t alive_count_change = 0;
  std::int32_t not_alive_count_change = 0;
};
using QOSLivelinessChangedInfo = LivelinessChangedInfo;

namespace detail {

struct EventCallbacks {
  std::function<void(MatchedInfo&)> matched;
  std::function<void(IncompatibleQosInfo&)> incompatible_qos;
  std::function<void(IncompatibleTypeInfo&)> incompatible_type;
  std::function<void(ConnectionInfo&)> connection;
  std::function<void(HeapCollisionInfo&)> heap_collision;
  std::function<void(HoldQuotaInfo&)> hold_quota;  // of a subscription
  std::function<void(DeadlineMissedInfo&)> deadline;
  std::function<void(LivelinessLostInfo&)> liveliness_lost;        // of a publisher
  std::function<void(LivelinessChangedInfo&)> liveliness_changed;  // of a subscription
  /// For services: all unread messages of a dead publisher were read or lost; it sends nothing
  /// more.
  std::function<void()> publisher_exhausted;
  explicit operator bool() const noexcept {
    return matched != nullptr || incompatible_qos != nullptr || incompatible_type != nullptr ||
           connection != nullptr || heap_collision != nullptr || hold_quota != nullptr ||
           deadline != nullptr || liveliness_lost != nullptr || liveliness_changed != nullptr ||
           publisher_exhausted != nullptr;
  }
};

/// The event setters of PublisherOptions and SubscriptionOptions.
template <class Options>
class EventOptions {
 public:
  Options& matched_callback(std::function<void(MatchedInfo&)> callback) {
    return events_.matched = std::move(callback), static_cast<Options&>(*this);
  }
  Options& incompatible_qos_callback(std::function<void(IncompatibleQosInfo&)> callback) {
    return events_.incompatible_qos = std::move(callback), static_cast<Options&>(*this);
  }
  Options& incompatible_type_callback(std::function<void(IncompatibleTypeInfo&)> callback) {
    return events_.incompatible_type = std::move(callback), static_cast<Options&>(*this);
  }
  /// Called when connection_state() has changed, with the new state.
  Options& connection_callback(std::function<void(ConnectionInfo&)> callback) {
    return events_.connection = std::move(callback), static_cast<Options&>(*this);
  }
  Options& heap_collision_callback(std::function<void(HeapCollisionInfo&)> callback) {
    return events_.heap_collision = std::move(callback), static_cast<Options&>(*this);
  }
  /// Needs a deadline in the QoS.
  Options& deadline_callback(std::function<void(DeadlineMissedInfo&)> callback) {
    return events_.deadline = std::move(callback), static_cast<Options&>(*this);
  }
  const EventCallbacks& events() const noexcept { return events_; }

 protected:
  EventCallbacks events_;
};

}  // namespace detail
}  // namespace agnocast
