// SPDX-License-Identifier: Apache-2.0
//
// Events of an endpoint as rmw has them: what has changed since somebody took it, for a wait set to
// wait for.
//
// The library counts; a wait set only looks whether a count has changed. What it finds is kept here
// until it is taken, because a look of the library's getters takes the change away.
#pragma once

#include <agnocast/events.hpp>
#include <agnocast/publisher.hpp>
#include <agnocast/subscription.hpp>
#include <ros2/rmw_agnocast_cpp/core/listener.hpp>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <mutex>
#include <type_traits>

namespace agnocast::rmw {

/// Messages that a subscription lost: its depth was exceeded, or they could not be read. Noticed
/// when somebody takes.
struct MessageLostInfo {
  std::uint64_t total_count = 0;
  std::uint64_t total_count_change = 0;
};

namespace detail {

/// Adds what is new to what was not taken yet; returns how often it has changed.
template <class Info>
std::uint64_t add_changes(Info& kept, const Info& now) noexcept {
  const auto change = kept.total_count_change + now.total_count_change;
  kept = now;
  kept.total_count_change = change;
  return static_cast<std::uint64_t>(now.total_count_change);
}
inline std::uint64_t add_changes(LivelinessChangedInfo& kept,
                                 const LivelinessChangedInfo& now) noexcept {
  const std::int32_t alive = kept.alive_count_change + now.alive_count_change;
  const std::int32_t not_alive = kept.not_alive_count_change + now.not_alive_count_change;
  kept = now;
  kept.alive_count_change = alive;
  kept.not_alive_count_change = not_alive;
  // A publisher that is alive no more changes both.
  return static_cast<std::uint64_t>(
      std::max(std::abs(now.alive_count_change), std::abs(now.not_alive_count_change)));
}
template <class Info>
void take_changes(Info& kept) noexcept {
  kept.total_count_change = 0;
}
inline void take_changes(LivelinessChangedInfo& kept) noexcept {
  kept.alive_count_change = kept.not_alive_count_change = 0;
}

}  // namespace detail

/// What the time alone may change: a look moves get_event_due() on.
template <class Info>
inline constexpr bool is_timed =
    std::is_same_v<Info, DeadlineMissedInfo> || std::is_same_v<Info, LivelinessLostInfo> ||
    std::is_same_v<Info, LivelinessChangedInfo>;

/// One kind of event of one endpoint, which must outlive it. Any thread.
template <class Info, class Endpoint, Info (*look)(Endpoint&, const Info& last) noexcept>
class Event final : public Listenable {
 public:
  explicit Event(Endpoint& endpoint) noexcept : endpoint_(endpoint) {}

  bool is_ready() const noexcept override {
    const std::lock_guard lock(mutex_);
    gather();
    return changes_.unread != 0;
  }
  Arrivals arrivals() const noexcept override {
    const std::lock_guard lock(mutex_);
    gather();
    return changes_;
  }
  Clock::time_point look_due() const noexcept override {
    return is_timed<Info> ? endpoint_.get_event_due() : Clock::time_point::max();
  }
  /// Returns the counts and their changes since the last call.
  Info take() noexcept {
    const std::lock_guard lock(mutex_);
    gather();
    changes_.unread = 0;
    const Info taken = kept_;
    detail::take_changes(kept_);
    return taken;
  }

 private:
  void gather() const noexcept {
    const std::uint64_t changes = detail::add_changes(kept_, look(endpoint_, kept_));
    changes_.count += changes;
    changes_.unread += changes;
  }

  Endpoint& endpoint_;
  mutable std::mutex mutex_;
  mutable Info kept_{};
  mutable Arrivals changes_;
};

/// The events of a publisher.
class PublisherEvents {
  template <class Info, Info (PublisherBase::*get)() noexcept>
  static Info look(PublisherBase& endpoint, const Info&) noexcept {
    return (endpoint.*get)();
  }
  template <class Info, Info (PublisherBase::*get)() noexcept>
  using Of = Event<Info, PublisherBase, &look<Info, get>>;

 public:
  explicit PublisherEvents(PublisherBase& publisher) noexcept
      : deadline_missed(publisher), liveliness_lost(publisher), incompatible_qos(publisher) {}

  std::array<Listenable*, 3> all() noexcept {
    return {&deadline_missed, &liveliness_lost, &incompatible_qos};
  }

  Of<DeadlineMissedInfo, &PublisherBase::get_deadline_missed_status> deadline_missed;
  Of<LivelinessLostInfo, &PublisherBase::get_liveliness_lost_status> liveliness_lost;
  Of<IncompatibleQosInfo, &PublisherBase::get_incompatible_qos_status> incompatible_qos;
};

/// The events of a subscription.
class SubscriptionEvents {
  template <class Info, Info (SubscriptionBase::*get)() noexcept>
  static Info look(SubscriptionBase& endpoint, const Info&) noexcept {
    return (endpoint.*get)();
  }
  static MessageLostInfo look_for_lost(SubscriptionBase& endpoint,
                                       const MessageLostInfo& last) noexcept {
    const std::uint64_t now = endpoint.get_lost_count();
    return {now, now - last.total_count};
  }
  template <class Info, Info (SubscriptionBase::*get)() noexcept>
  using Of = Event<Info, SubscriptionBase, &look<Info, get>>;

 public:
  explicit SubscriptionEvents(SubscriptionBase& subscription) noexcept
      : deadline_missed(subscription),
        liveliness_changed(subscription),
        incompatible_qos(subscription),
        message_lost(subscription) {}

  std::array<Listenable*, 4> all() noexcept {
    return {&deadline_missed, &liveliness_changed, &incompatible_qos, &message_lost};
  }

  Of<DeadlineMissedInfo, &SubscriptionBase::get_deadline_missed_status> deadline_missed;
  Of<LivelinessChangedInfo, &SubscriptionBase::get_liveliness_changed_status> liveliness_changed;
  Of<IncompatibleQosInfo, &SubscriptionBase::get_incompatible_qos_status> incompatible_qos;
  Event<MessageLostInfo, SubscriptionBase, &look_for_lost> message_lost;
};

}  // namespace agnocast::rmw
