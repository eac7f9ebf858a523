// SPDX-License-Identifier: Apache-2.0
//
// Events of an endpoint: who has matched it, who could not, and whether the daemon is there to bring
// others. Each is counted from the endpoint's first moment; a status getter tells the counts and what changed since it was asked last, a
// callback (set in the endpoint's options) is called when they change. Event callbacks run where
// the message callbacks of the node run, and count for themselves: asking for a status takes no
// change away from a callback.
#pragma once

#include <agnocast/connection_state.hpp>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <utility>

namespace agnocast {

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
  reliability = 1 << 4,
};

/// Endpoints of the topic that ask for more than is offered (or offer less than is asked for).
struct IncompatibleQosInfo {
  std::int32_t total_count = 0;
  std::int32_t total_count_change = 0;
  /// Of the newest of them. Where both policies are at fault it says reliability.
  QosPolicyKind last_policy_kind = QosPolicyKind::invalid;
};
using QOSOfferedIncompatibleQoSInfo = IncompatibleQosInfo;
using QOSRequestedIncompatibleQoSInfo = IncompatibleQosInfo;

/// Attempts of other processes to use the topic with another type, or the same type with another
/// layout. They were refused; a process is counted once.
struct IncompatibleTypeInfo {
  std::int32_t total_count = 0;
  std::int32_t total_count_change = 0;
};

/// Heaps that lie where a reader's process has something else (a JIT, a GPU's driver): a publisher is
/// told of its readers, a subscription of its publishers. What is published there is lost to that
/// reader; the text says whether the heap goes on elsewhere.
struct HeapCollisionInfo {
  std::int32_t total_count = 0;
  std::int32_t total_count_change = 0;
  /// Of the newest: which processes, which window, what happens now, which range is taken, and what is
  /// there if the reader is this user's. Ends with a NUL.
  char last_text[256] = "";
};

namespace detail {

struct EventCallbacks {
  std::function<void(MatchedInfo&)> matched;
  std::function<void(IncompatibleQosInfo&)> incompatible_qos;
  std::function<void(IncompatibleTypeInfo&)> incompatible_type;
  std::function<void(ConnectionInfo&)> connection;
  std::function<void(HeapCollisionInfo&)> heap_collision;
  /// For services: what was unread of a publisher that is gone is lost, and nothing more comes of it.
  std::function<void()> drained;
  explicit operator bool() const noexcept {
    return matched != nullptr || incompatible_qos != nullptr || incompatible_type != nullptr ||
           connection != nullptr || heap_collision != nullptr || drained != nullptr;
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
  /// Called when connection_state() has changed, with what it is now.
  Options& connection_callback(std::function<void(ConnectionInfo&)> callback) {
    return events_.connection = std::move(callback), static_cast<Options&>(*this);
  }
  Options& heap_collision_callback(std::function<void(HeapCollisionInfo&)> callback) {
    return events_.heap_collision = std::move(callback), static_cast<Options&>(*this);
  }
  const EventCallbacks& events() const noexcept { return events_; }

 protected:
  EventCallbacks events_;
};

}  // namespace detail
}  // namespace agnocast
