// SPDX-License-Identifier: Apache-2.0
//
// Quality of service, meaning what it means in ROS 2. An rclcpp::QoS (anything with its getters)
// converts to it.
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
  /// Keep-last: a publisher keeps that many messages for late joiners if it is transient-local; a
  /// subscription gets that many unread messages, whatever the publisher's depth is. 0 and depths
  /// above the daemon's limit are refused at creation. A number where a QoS is wanted is a depth.
  QoS(std::size_t depth) noexcept : depth_(depth) {}
  /// From an rclcpp::QoS or whatever else has depth(), history(), reliability() and durability() in
  /// rmw's numbers. Keep-all has no depth in ROS 2, so its bound is the one of keep_all(); the
  /// system's default history without a depth is the last message, as in DDS. "Best available" is
  /// what matches everybody: a publisher is reliable, a subscription takes best effort, and both
  /// are volatile. It is decided by the kind of endpoint, not by who is there at its creation.
  template <class Like, class = decltype(std::declval<const Like&>().depth(),
                                         std::declval<const Like&>().history(),
                                         std::declval<const Like&>().reliability(),
                                         std::declval<const Like&>().durability())>
  QoS(const Like& like) noexcept
      : depth_(depth_of(static_cast<std::size_t>(like.depth()), static_cast<int>(like.history()))),
        keep_all_(static_cast<int>(like.history()) == rmw_keep_all),
        reliable_(static_cast<int>(like.reliability()) != rmw_best_effort),
        best_available_(static_cast<int>(like.reliability()) == rmw_best_available),
        transient_local_(static_cast<int>(like.durability()) == rmw_transient_local) {}

  QoS& keep_last(std::size_t depth) noexcept { return depth_ = depth, keep_all_ = false, *this; }
  /// On both sides, both reliable: nothing is lost, and the publisher gets would_block where it would
  /// overrun the subscription. A keep-last publisher is not held up, also by a keep-all subscription,
  /// which then loses what is beyond `bound`: the unread messages at most (of both, the smaller).
  QoS& keep_all(std::size_t bound = keep_all_bound) noexcept {
    return depth_ = bound, keep_all_ = true, *this;
  }
  QoS& reliable() noexcept { return reliable_ = true, best_available_ = false, *this; }
  QoS& best_effort() noexcept { return reliable_ = false, best_available_ = false, *this; }
  QoS& transient_local() noexcept { return transient_local_ = true, *this; }
  QoS& durability_volatile() noexcept { return transient_local_ = false, *this; }

  std::size_t depth() const noexcept { return depth_; }
  bool is_keep_all() const noexcept { return keep_all_; }
  /// Of a publisher. A subscription whose reliability is the best available is not.
  bool is_reliable() const noexcept { return reliable_; }
  bool is_best_available() const noexcept { return best_available_; }
  bool is_transient_local() const noexcept { return transient_local_; }

 private:
  // rmw/types.h: history system_default and keep_all, reliability best_effort and
  // best_available, durability transient_local.
  static constexpr int rmw_default_history = 0;
  static constexpr int rmw_keep_all = 2;
  static constexpr int rmw_best_effort = 2;
  static constexpr int rmw_best_available = 4;
  static constexpr int rmw_transient_local = 1;
  // The default of the daemon's depth_max.
  static constexpr std::size_t keep_all_bound = 1000;
  static constexpr std::size_t depth_of(std::size_t depth, int history) noexcept {
    if (history == rmw_keep_all) return keep_all_bound;
    return history == rmw_default_history && depth == 0 ? 1 : depth;
  }

  std::size_t depth_;
  bool keep_all_ = false;
  bool reliable_ = true;
  bool best_available_ = false;
  bool transient_local_ = false;
};

}  // namespace agnocast
