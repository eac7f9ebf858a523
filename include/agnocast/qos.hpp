// SPDX-License-Identifier: Apache-2.0
//
// Quality of service with the meaning of ROS 2. An rclcpp::QoS (or any class with its getters) and
// a profile of rmw convert to it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>

namespace agnocast {

/// History, reliability and durability of an endpoint. Default: keep-last of the given depth,
/// reliable, volatile (rclcpp's default). Publisher and subscription match if the publisher offers
/// at least what the subscription requests (DDS 1.4, 2.2.3). Any thread; plain data.
class QoS {
 public:
  /// Keep-last: a transient-local publisher keeps `depth` messages for late joiners; a
  /// subscription keeps that many unread messages, whatever the publisher's depth is. Creation
  /// refuses 0 and depths above the daemon's limit. A number converts to a QoS with that depth.
  QoS(std::size_t depth) noexcept : depth_(depth) {}
  /// Converts an rclcpp::QoS, or any class with depth(), history(), reliability() and
  /// durability() in rmw's numbers. Keep-all has no depth in ROS 2, so it gets the bound of
  /// keep_all(); the system's default history without a depth keeps the last message, as in DDS.
  /// "Best available" becomes the value that matches every peer: a publisher is reliable, a
  /// subscription best effort, and both are volatile. That depends on the kind of endpoint, not
  /// on the endpoints present at its creation.
  template <class Like, class = decltype(std::declval<const Like&>().depth(),
                                         std::declval<const Like&>().history(),
                                         std::declval<const Like&>().reliability(),
                                         std::declval<const Like&>().durability())>
  QoS(const Like& like) noexcept
      : QoS(RmwPolicies{static_cast<std::size_t>(like.depth()), static_cast<int>(like.history()),
                        static_cast<int>(like.reliability()), static_cast<int>(like.durability()),
                        unserved_of(like, 0)}) {}
  /// Converts an rmw_qos_profile_t in the same way, or any class with its data members.
  template <class Profile,
            class = decltype(std::size_t{std::declval<const Profile&>().depth},
                             static_cast<int>(std::declval<const Profile&>().history),
                             static_cast<int>(std::declval<const Profile&>().reliability),
                             static_cast<int>(std::declval<const Profile&>().durability)),
            class = void>
  QoS(const Profile& profile) noexcept
      : QoS(RmwPolicies{profile.depth, static_cast<int>(profile.history),
                        static_cast<int>(profile.reliability), static_cast<int>(profile.durability),
                        unserved_of_profile(profile, 0)}) {}

  QoS& keep_last(std::size_t depth) noexcept { return depth_ = depth, keep_all_ = false, *this; }
  /// With reliable keep-all on both sides nothing is lost: the publisher gets would_block where
  /// it would overrun the subscription. A keep-last publisher never waits, not even for a
  /// keep-all subscription, which then loses messages beyond `bound`. `bound` limits the unread
  /// messages (the smaller one of both sides).
  QoS& keep_all(std::size_t bound = keep_all_bound) noexcept {
    return depth_ = bound, keep_all_ = true, *this;
  }
  QoS& reliable() noexcept { return reliable_ = true, best_available_ = false, *this; }
  QoS& best_effort() noexcept { return reliable_ = false, best_available_ = false, *this; }
  QoS& transient_local() noexcept { return transient_local_ = true, *this; }
  QoS& durability_volatile() noexcept { return transient_local_ = false, *this; }

  /// Converts to an rclcpp::QoS, or any class with its functions.
  template <class Like,
            class = decltype(Like(std::size_t{1}).keep_all().best_effort().transient_local())>
  operator Like() const {
    Like like(depth_);
    if (keep_all_) like.keep_all();
    if (!reliable_) like.best_effort();
    if (transient_local_) like.transient_local();
    return like;
  }

  std::size_t depth() const noexcept { return depth_; }
  bool is_keep_all() const noexcept { return keep_all_; }
  /// For a publisher. A subscription with "best available" reliability is not reliable.
  bool is_reliable() const noexcept { return reliable_; }
  bool is_best_available() const noexcept { return best_available_; }
  bool is_transient_local() const noexcept { return transient_local_; }

  /// Policies that the converted QoS or profile had and that have no effect here: bits.
  static constexpr std::uint8_t deadline = 1, lifespan = 2, liveliness = 4;
  std::uint8_t unserved() const noexcept { return unserved_; }

 private:
  // rmw/types.h: history system_default and keep_all, reliability best_effort and
  // best_available, durability transient_local.
  static constexpr int rmw_default_history = 0;
  static constexpr int rmw_keep_all = 2;
  static constexpr int rmw_best_effort = 2;
  static constexpr int rmw_best_available = 4;
  static constexpr int rmw_transient_local = 1;
  static constexpr int rmw_manual_by_topic = 3;
  // The default of the daemon's depth_max.
  static constexpr std::size_t keep_all_bound = 1000;
  static constexpr std::size_t depth_of(std::size_t depth, int history) noexcept {
    if (history == rmw_keep_all) return keep_all_bound;
    return history == rmw_default_history && depth == 0 ? 1 : depth;
  }
  // No deadline, lifespan or lease: 0, or infinite, which is the largest number of nanoseconds.
  static constexpr bool is_set(std::int64_t nanoseconds) noexcept {
    return nanoseconds > 0 && nanoseconds < INT64_MAX;
  }
  template <class Time>
  static constexpr bool is_set(const Time& time) noexcept {
    return (time.sec != 0 || time.nsec != 0) && time.sec < INT64_MAX / 1'000'000'000;
  }
  static constexpr std::uint8_t bits_of(bool has_deadline, bool has_lifespan, bool has_lease,
                                        int liveliness_kind) noexcept {
    const bool has_liveliness = has_lease || liveliness_kind == rmw_manual_by_topic;
    return static_cast<std::uint8_t>((has_deadline ? deadline : 0) | (has_lifespan ? lifespan : 0) |
                                     (has_liveliness ? liveliness : 0));
  }
  template <class Like>
  static auto unserved_of(const Like& like, int) noexcept
      -> decltype(like.liveliness_lease_duration().nanoseconds(), std::uint8_t{}) {
    return bits_of(is_set(like.deadline().nanoseconds()), is_set(like.lifespan().nanoseconds()),
                   is_set(like.liveliness_lease_duration().nanoseconds()),
                   static_cast<int>(like.liveliness()));
  }
  template <class Like>
  static std::uint8_t unserved_of(const Like&, long) noexcept {
    return 0;
  }
  template <class Profile>
  static auto unserved_of_profile(const Profile& profile, int) noexcept
      -> decltype(profile.liveliness_lease_duration.nsec, std::uint8_t{}) {
    return bits_of(is_set(profile.deadline), is_set(profile.lifespan),
                   is_set(profile.liveliness_lease_duration), static_cast<int>(profile.liveliness));
  }
  template <class Profile>
  static std::uint8_t unserved_of_profile(const Profile&, long) noexcept {
    return 0;
  }
  struct RmwPolicies {
    std::size_t depth;
    int history, reliability, durability;
    std::uint8_t unserved;
  };
  explicit QoS(const RmwPolicies& policies) noexcept
      : depth_(depth_of(policies.depth, policies.history)),
        keep_all_(policies.history == rmw_keep_all),
        reliable_(policies.reliability != rmw_best_effort),
        best_available_(policies.reliability == rmw_best_available),
        transient_local_(policies.durability == rmw_transient_local),
        unserved_(policies.unserved) {}

  std::size_t depth_;
  bool keep_all_ = false;
  bool reliable_ = true;
  bool best_available_ = false;
  bool transient_local_ = false;
  std::uint8_t unserved_ = 0;
};

}  // namespace agnocast
