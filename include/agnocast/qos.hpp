// SPDX-License-Identifier: Apache-2.0
//
// Quality of service with the meaning of ROS 2. An rclcpp::QoS (or any class with its getters) and
// a profile of rmw convert to it.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>

namespace agnocast {

/// How a publisher is known to be alive. Numbers as in rmw_qos_liveliness_policy_t.
enum class Liveliness : std::uint8_t {
  automatic = 1,        ///< its process is
  manual_by_topic = 3,  ///< it publishes, or asserts its liveliness
};

namespace detail {

struct QosTimes {
  std::chrono::nanoseconds deadline{0}, lifespan{0}, lease{0};
  Liveliness liveliness = Liveliness::automatic;
};

}  // namespace detail

/// History, reliability, durability, deadline, lifespan and liveliness of an endpoint. Default:
/// keep-last of the given depth, reliable, volatile, no times (rclcpp's default). Publisher and
/// subscription match if the publisher offers at least what the subscription requests (DDS 1.4,
/// 2.2.3). Any thread; plain data.
class QoS {
 public:
  /// Keep-last: a transient-local publisher keeps `depth` messages for late joiners; a
  /// subscription keeps that many unread messages, whatever the publisher's depth is. Creation
  /// refuses 0 and depths above the daemon's limit. A number converts to a QoS with that depth.
  QoS(std::size_t depth) noexcept : depth_(depth) {}
  /// Converts an rclcpp::QoS, or any class with depth(), history(), reliability() and
  /// durability() in rmw's numbers. Keep-all has no depth in ROS 2, so it gets the bound of
  /// keep_all(). A depth of 0, which rclcpp::SystemDefaultsQoS has, is the system's default in
  /// ROS 2: the last message, as in DDS.
  /// "Best available" becomes the value that matches every peer without times: a publisher is
  /// reliable, a subscription best effort, and both are volatile, with automatic liveliness and no
  /// times. That depends on the kind of endpoint, not on the endpoints present at its creation.
  template <class Like, class = decltype(std::declval<const Like&>().depth(),
                                         std::declval<const Like&>().history(),
                                         std::declval<const Like&>().reliability(),
                                         std::declval<const Like&>().durability())>
  QoS(const Like& like) noexcept
      : QoS(RmwPolicies{static_cast<std::size_t>(like.depth()), static_cast<int>(like.history()),
                        static_cast<int>(like.reliability()), static_cast<int>(like.durability()),
                        times_of(like, 0)}) {}
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
                        times_of_profile(profile, 0)}) {}

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
  /// Times: 0 is none, the default. Creation refuses negative ones.
  ///
  /// A publisher promises to publish at least once in this time, a subscription requests that.
  QoS& deadline(std::chrono::nanoseconds time) noexcept { return times_.deadline = time, *this; }
  /// A publisher's messages are taken only until they are this old. Their memory is used until each
  /// subscription has passed over them. Without effect on a subscription.
  QoS& lifespan(std::chrono::nanoseconds time) noexcept { return times_.lifespan = time, *this; }
  QoS& liveliness(Liveliness kind) noexcept { return times_.liveliness = kind, *this; }
  /// With manual_by_topic, a publisher that is silent for this time is not alive. A process that
  /// dies takes its publishers along at once, whatever their lease is.
  QoS& liveliness_lease_duration(std::chrono::nanoseconds time) noexcept {
    return times_.lease = time, *this;
  }

  /// Converts to an rclcpp::QoS, or any class with its functions.
  template <class Like,
            class = decltype(Like(std::size_t{1}).keep_all().best_effort().transient_local())>
  operator Like() const {
    Like like(depth_);
    if (keep_all_) like.keep_all();
    if (!reliable_) like.best_effort();
    if (transient_local_) like.transient_local();
    give_times(like, 0);
    return like;
  }

  std::size_t depth() const noexcept { return depth_; }
  bool is_keep_all() const noexcept { return keep_all_; }
  /// For a publisher. A subscription with "best available" reliability is not reliable.
  bool is_reliable() const noexcept { return reliable_; }
  bool is_best_available() const noexcept { return best_available_; }
  bool is_transient_local() const noexcept { return transient_local_; }
  std::chrono::nanoseconds deadline() const noexcept { return times_.deadline; }
  std::chrono::nanoseconds lifespan() const noexcept { return times_.lifespan; }
  Liveliness liveliness() const noexcept { return times_.liveliness; }
  std::chrono::nanoseconds liveliness_lease_duration() const noexcept { return times_.lease; }

 private:
  // rmw/types.h: history keep_all, reliability best_effort and best_available, durability
  // transient_local; depth system_default.
  static constexpr std::size_t rmw_default_depth = 0;
  static constexpr int rmw_keep_all = 2;
  static constexpr int rmw_best_effort = 2;
  static constexpr int rmw_best_available = 4;
  static constexpr int rmw_transient_local = 1;
  // The default of the daemon's depth_max.
  static constexpr std::size_t keep_all_bound = 1000;
  static constexpr std::size_t depth_of(std::size_t depth, int history) noexcept {
    if (history == rmw_keep_all) return keep_all_bound;
    return depth == rmw_default_depth ? 1 : depth;
  }
  using Times = detail::QosTimes;
  // rmw/types.h: infinite is the largest number of nanoseconds, best available the one before it.
  static constexpr std::chrono::nanoseconds time_of(std::int64_t nanoseconds) noexcept {
    return std::chrono::nanoseconds(nanoseconds >= INT64_MAX - 1 ? 0 : nanoseconds);
  }
  template <class Time>
  static constexpr std::chrono::nanoseconds time_of(const Time& time) noexcept {
    constexpr std::uint64_t second = 1'000'000'000, most = INT64_MAX;
    const std::uint64_t seconds = time.sec, rest = time.nsec;
    const bool is_finite = seconds < most / second && rest < most - seconds * second;
    return time_of(is_finite ? static_cast<std::int64_t>(seconds * second + rest) : INT64_MAX);
  }
  static constexpr Liveliness liveliness_of(int number) noexcept {
    return number == static_cast<int>(Liveliness::manual_by_topic) ? Liveliness::manual_by_topic
                                                                   : Liveliness::automatic;
  }
  template <class Like>
  static auto times_of(const Like& like, int) noexcept
      -> decltype(like.liveliness_lease_duration().nanoseconds(), Times{}) {
    return {time_of(like.deadline().nanoseconds()), time_of(like.lifespan().nanoseconds()),
            time_of(like.liveliness_lease_duration().nanoseconds()),
            liveliness_of(static_cast<int>(like.liveliness()))};
  }
  template <class Like>
  static Times times_of(const Like&, long) noexcept {
    return {};
  }
  template <class Profile>
  static auto times_of_profile(const Profile& profile, int) noexcept
      -> decltype(profile.liveliness_lease_duration.nsec, Times{}) {
    return {time_of(profile.deadline), time_of(profile.lifespan),
            time_of(profile.liveliness_lease_duration),
            liveliness_of(static_cast<int>(profile.liveliness))};
  }
  template <class Profile>
  static Times times_of_profile(const Profile&, long) noexcept {
    return {};
  }
  template <class Like>
  auto give_times(Like& like, int) const
      -> decltype(like.liveliness_lease_duration(std::chrono::nanoseconds{}), void()) {
    if (times_.deadline.count() != 0) like.deadline(times_.deadline);
    if (times_.lifespan.count() != 0) like.lifespan(times_.lifespan);
    if (times_.lease.count() != 0) like.liveliness_lease_duration(times_.lease);
    if (times_.liveliness != Liveliness::automatic)
      like.liveliness(static_cast<std::decay_t<decltype(like.liveliness())>>(times_.liveliness));
  }
  template <class Like>
  void give_times(Like&, long) const noexcept {}
  struct RmwPolicies {
    std::size_t depth;
    int history, reliability, durability;
    Times times;
  };
  explicit QoS(const RmwPolicies& policies) noexcept
      : depth_(depth_of(policies.depth, policies.history)),
        keep_all_(policies.history == rmw_keep_all),
        reliable_(policies.reliability != rmw_best_effort),
        best_available_(policies.reliability == rmw_best_available),
        transient_local_(policies.durability == rmw_transient_local),
        times_(policies.times) {}

  std::size_t depth_;
  bool keep_all_ = false;
  bool reliable_ = true;
  bool best_available_ = false;
  bool transient_local_ = false;
  Times times_;
};

}  // namespace agnocast
