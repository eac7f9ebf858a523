// SPDX-License-Identifier: Apache-2.0

#include <agnocast_rclcpp/options.hpp>

#include <rmw/incompatible_qos_events_statuses.h>
#include <rclcpp/detail/resolve_enable_topic_statistics.hpp>
#include <rclcpp/logging.hpp>

#include <algorithm>
#include <atomic>
#include <memory>
#include <string>
#include <utility>

namespace agnocast_rclcpp {
namespace {

template <class Options>
Options without_group(Options options) {
  if (options.callback_group() != nullptr)
    throw agnocast::Error({agnocast::Errc::invalid_argument, 0,
                           "an endpoint of an rclcpp node takes rclcpp's callback groups"});
  return options;
}

const char* name_of(agnocast::QosPolicyKind kind) {
  switch (kind) {
    case agnocast::QosPolicyKind::durability:
      return "DURABILITY";
    case agnocast::QosPolicyKind::deadline:
      return "DEADLINE";
    case agnocast::QosPolicyKind::liveliness:
      return "LIVELINESS";
    case agnocast::QosPolicyKind::liveliness_lease_duration:
      return "LIVELINESS_LEASE_DURATION";
    default:
      return "RELIABILITY";
  }
}

/// rmw's structure for both sides; the numbers of the policies are rmw's.
template <class Info>
Info to_rmw(const agnocast::IncompatibleQosInfo& info) {
  Info status{};
  status.total_count = info.total_count;
  status.total_count_change = info.total_count_change;
  status.last_policy_kind = static_cast<rmw_qos_policy_kind_t>(info.last_policy_kind);
  return status;
}

void warn_of(bool given, const char* what, const std::string& topic, const rclcpp::Logger& logger) {
  if (given)
    RCLCPP_WARN(logger, "%s has no effect on '%s', which agnocast serves", what, topic.c_str());
}

/// Callbacks that rclcpp has since Iron. Before, these two return false.
template <class Events>
auto has_matched(const Events& events, int) -> decltype(bool(events.matched_callback)) {
  return bool(events.matched_callback);
}
template <class Events>
bool has_matched(const Events&, long) {
  return false;
}
template <class Events>
auto has_incompatible_type(const Events& events, int)
    -> decltype(bool(events.incompatible_type_callback)) {
  return bool(events.incompatible_type_callback);
}
template <class Events>
bool has_incompatible_type(const Events&, long) {
  return false;
}
template <class Events>
void warn_of_newer(const Events& events, const std::string& topic, const rclcpp::Logger& logger) {
  warn_of(has_matched(events, 0), "matched_callback", topic, logger);
  warn_of(has_incompatible_type(events, 0), "incompatible_type_callback", topic, logger);
}

}  // namespace

SubscriptionOptions::SubscriptionOptions(agnocast::SubscriptionOptions options)
    : own(without_group(std::move(options))) {}
PublisherOptions::PublisherOptions(agnocast::PublisherOptions options)
    : own(without_group(std::move(options))) {}

agnocast::SubscriptionOptions translate(const SubscriptionOptions& options,
                                        const std::string& topic, const rclcpp::Logger& logger,
                                        const rclcpp::node_interfaces::NodeBaseInterface& base) {
  agnocast::SubscriptionOptions translated = options.own;
  const rclcpp::SubscriptionEventCallbacks& events = options.ros.event_callbacks;
  if (events.deadline_callback && options.own.events().deadline == nullptr) {
    translated.deadline_callback(
        [call = events.deadline_callback](agnocast::DeadlineMissedInfo& info) {
          rclcpp::QOSDeadlineRequestedInfo status{info.total_count, info.total_count_change};
          call(status);
        });
  }
  if (events.liveliness_callback && options.own.events().liveliness_changed == nullptr) {
    translated.liveliness_callback([call = events.liveliness_callback](
                                       agnocast::LivelinessChangedInfo& info) {
      rclcpp::QOSLivelinessChangedInfo status{info.alive_count, info.not_alive_count,
                                              info.alive_count_change, info.not_alive_count_change};
      call(status);
    });
  }
  warn_of(events.message_lost_callback != nullptr, "message_lost_callback", topic, logger);
  warn_of_newer(events, topic, logger);
  warn_of(!options.ros.content_filter_options.filter_expression.empty(), "content_filter_options",
          topic, logger);
  warn_of(rclcpp::detail::resolve_enable_topic_statistics(options.ros, base),
          "collecting topic statistics", topic, logger);
  if (options.ros.ignore_local_publications) translated.ignore_local_publications();
  if (options.own.events().hold_quota == nullptr && options.ros.use_default_callbacks) {
    const auto has_warned = std::make_shared<std::atomic<bool>>(false);
    translated.hold_quota_callback([topic, logger, has_warned](agnocast::HoldQuotaInfo&) {
      if (has_warned->exchange(true)) return;
      RCLCPP_WARN(logger,
                  "The subscription of topic '%s' keeps as many messages of a publisher as it "
                  "may, and gets no further one until it releases one. hold_quota of its "
                  "agnocast::SubscriptionOptions lets it keep more of publishers of its own user",
                  topic.c_str());
    });
  }
  if (options.own.events().incompatible_qos != nullptr) return translated;
  if (events.incompatible_qos_callback) {
    translated.incompatible_qos_callback(
        [call = events.incompatible_qos_callback](agnocast::IncompatibleQosInfo& info) {
          auto status = to_rmw<rclcpp::QOSRequestedIncompatibleQoSInfo>(info);
          call(status);
        });
  } else if (options.ros.use_default_callbacks) {
    translated.incompatible_qos_callback([topic, logger](agnocast::IncompatibleQosInfo& info) {
      RCLCPP_WARN(logger,
                  "New publisher discovered on topic '%s', offering incompatible QoS. No messages "
                  "will be received from it. Last incompatible policy: %s",
                  topic.c_str(), name_of(info.last_policy_kind));
    });
  }
  return translated;
}

void allow_queue(agnocast::SubscriptionOptions& options, std::size_t length) {
  // Many large quotas could take all slots of a publisher together (maximum_slot_count).
  constexpr std::size_t quota_max = 512;
  if (options.is_hold_quota_usual())
    options.hold_quota_or_less(std::clamp(length, options.hold_quota(), quota_max));
}

agnocast::PublisherOptions translate(const PublisherOptions& options, const std::string& topic,
                                     const rclcpp::Logger& logger) {
  agnocast::PublisherOptions translated = options.own;
  const rclcpp::PublisherEventCallbacks& events = options.ros.event_callbacks;
  if (events.deadline_callback && options.own.events().deadline == nullptr) {
    translated.deadline_callback(
        [call = events.deadline_callback](agnocast::DeadlineMissedInfo& info) {
          rclcpp::QOSDeadlineOfferedInfo status{info.total_count, info.total_count_change};
          call(status);
        });
  }
  if (events.liveliness_callback && options.own.events().liveliness_lost == nullptr) {
    translated.liveliness_callback(
        [call = events.liveliness_callback](agnocast::LivelinessLostInfo& info) {
          rclcpp::QOSLivelinessLostInfo status{info.total_count, info.total_count_change};
          call(status);
        });
  }
  warn_of_newer(events, topic, logger);
  if (options.own.events().incompatible_qos != nullptr) return translated;
  if (events.incompatible_qos_callback) {
    translated.incompatible_qos_callback(
        [call = events.incompatible_qos_callback](agnocast::IncompatibleQosInfo& info) {
          auto status = to_rmw<rclcpp::QOSOfferedIncompatibleQoSInfo>(info);
          call(status);
        });
  } else if (options.ros.use_default_callbacks) {
    translated.incompatible_qos_callback([topic, logger](agnocast::IncompatibleQosInfo& info) {
      RCLCPP_WARN(logger,
                  "New subscription discovered on topic '%s', requesting incompatible QoS. No "
                  "messages will be sent to it. Last incompatible policy: %s",
                  topic.c_str(), name_of(info.last_policy_kind));
    });
  }
  return translated;
}

}  // namespace agnocast_rclcpp
