// SPDX-License-Identifier: Apache-2.0
//
// What publishers and subscriptions of every message type share.
#pragma once

#include <agnocastlib/core.hpp>

#include <agnocast/connection_state.hpp>

#include <rmw/types.h>
#include <rclcpp/callback_group.hpp>
#include <rclcpp/logger.hpp>
#include <rclcpp/node_interfaces/node_base_interface.hpp>
#include <rclcpp/qos.hpp>
#include <rclcpp/qos_overriding_options.hpp>

#include <cstddef>
#include <cstdint>
#include <string>

namespace agnocast {

/// The options of a publisher.
struct PublisherOptions {
  bool do_always_ros2_publish = false;  ///< without effect; true is logged
  rclcpp::QosOverridingOptions qos_overriding_options{};
};

/// The options of a subscription.
struct SubscriptionOptions {
  rclcpp::CallbackGroup::SharedPtr callback_group{nullptr};  ///< null: the default group
  bool ignore_local_publications{false};                     ///< as rclcpp's
  rclcpp::QosOverridingOptions qos_overriding_options{};
  /// Messages of one publisher that may be held at once; further ones stay unread. Of publishers of
  /// other users it may be less. 0: the depth, but at least 64 and at most 512. Not an option of
  /// the kernel-module system.
  std::size_t hold_quota{0};
};

}  // namespace agnocast

namespace agnocastlib {

/// Return the options for the library below. The first logs what has no effect in the options;
/// callback groups that are spun log later that the process has lost agnocastd.
agnocast_rclcpp::PublisherOptions translate(const agnocast::PublisherOptions& options,
                                            const std::string& topic, const rclcpp::Logger& logger);
agnocast_rclcpp::SubscriptionOptions translate(const agnocast::SubscriptionOptions& options);

/// Logs that the process has lost agnocastd, at most once a second for the process.
void report_lost_daemon() noexcept;
/// Calls it if that is so. Costs no system call otherwise.
inline void report_if_daemon_is_lost() noexcept {
  if (agnocast::connection_state() != agnocast::ConnectionState::connected) report_lost_daemon();
}

/// Keeps `group`, unless it is null, as long as the node lives. rclcpp's nodes do not: a group that
/// nobody keeps ends, and its callbacks never run. Any thread. This and the functions below do
/// nothing in a forked child.
void keep_group(const rclcpp::node_interfaces::NodeBaseInterface::SharedPtr& node,
                const rclcpp::CallbackGroup::SharedPtr& group);

/// Returns an id that no other publisher of this host has. Also in a forked child.
rmw_gid_t gid_of(std::uint64_t persistent_id) noexcept;

/// Throws std::runtime_error if the library of the kernel-module system is in this process: see
/// exclusion.cpp. Called whenever an endpoint is created. Any thread.
void refuse_other_system();

}  // namespace agnocastlib
