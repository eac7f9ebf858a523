// SPDX-License-Identifier: Apache-2.0
//
// The options that endpoints of rclcpp nodes take: those of rclcpp, or those of agnocast.
#pragma once

#include <agnocast/publisher.hpp>
#include <agnocast/subscription.hpp>

#include <rclcpp/node_interfaces/node_base_interface.hpp>
#include <rclcpp/publisher_options.hpp>
#include <rclcpp/subscription_options.hpp>

#include <utility>

namespace agnocast_rclcpp {

/// Either kind converts. The callback group is always rclcpp's.
class SubscriptionOptions {
 public:
  SubscriptionOptions() = default;
  template <class Allocator>
  SubscriptionOptions(const rclcpp::SubscriptionOptionsWithAllocator<Allocator>& options)
      : ros(options) {}
  /// Throws agnocast::Error (invalid_argument): it names a callback group of agnocast's.
  SubscriptionOptions(agnocast::core::SubscriptionOptions options);

  rclcpp::SubscriptionOptionsBase ros;
  agnocast::core::SubscriptionOptions own;
};

class PublisherOptions {
 public:
  PublisherOptions() = default;
  template <class Allocator>
  PublisherOptions(const rclcpp::PublisherOptionsWithAllocator<Allocator>& options)
      : ros(options) {}
  PublisherOptions(agnocast::core::PublisherOptions options);

  rclcpp::PublisherOptionsBase ros;
  agnocast::core::PublisherOptions own;
};

/// Returns the options for the library: what `options` says, with rclcpp's event callbacks, or its
/// default ones, which warn of incompatible QoS. Warns of what has no effect here.
agnocast::core::SubscriptionOptions translate(
    const SubscriptionOptions& options, const std::string& topic, const rclcpp::Logger& logger,
    const rclcpp::node_interfaces::NodeBaseInterface& base);
/// Unless `options` say otherwise, lets a node keep as many messages as its queue is long, up to
/// 512: nodes for rclcpp often keep what came in a queue of their own.
void allow_queue(agnocast::core::SubscriptionOptions& options, std::size_t length);
agnocast::core::PublisherOptions translate(const PublisherOptions& options,
                                           const std::string& topic, const rclcpp::Logger& logger);

}  // namespace agnocast_rclcpp
