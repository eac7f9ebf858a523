// SPDX-License-Identifier: Apache-2.0

#include <agnocastlib/endpoints.hpp>

#include <agnocastlib/failure_log.hpp>
#include <agnocastlib/forked_child.hpp>

#include <rclcpp/logging.hpp>

#include <algorithm>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <utility>
#include <vector>

namespace agnocastlib {
namespace {

void warn_of(bool given, const char* what, const std::string& topic, const rclcpp::Logger& logger) {
  if (given && !is_forked_child())
    RCLCPP_WARN(logger, "%s has no effect on '%s', which agnocast serves", what, topic.c_str());
}

/// One line a second is enough for the process, whatever its state, whichever thread notices.
void report_state(agnocast::ConnectionState state, agnocast::Errc reason) noexcept {
  const bool is_orphaned = state == agnocast::ConnectionState::orphaned;
  if ((!is_orphaned && state != agnocast::ConnectionState::reconnecting) || is_forked_child())
    return;
  static FailureLog* const log =
      new FailureLog(rclcpp::get_logger("agnocast"), "the connection to agnocastd");
  log->report(is_orphaned ? reason : agnocast::Errc::daemon_not_running);
}
void report_connection(agnocast::ConnectionInfo& info) { report_state(info.state, info.reason); }

using Groups = std::set<rclcpp::CallbackGroup::SharedPtr>;
using WeakNode = rclcpp::node_interfaces::NodeBaseInterface::WeakPtr;

/// Groups are not kept by the endpoints: Humble's executors use a condition of each group that they
/// have, which ends with it, so a group must not end with an endpoint while they spin.
struct KeptGroups {
  std::mutex mutex;
  std::map<WeakNode, Groups, std::owner_less<WeakNode>> groups;
};
KeptGroups& kept_groups() {
  static auto* const all = new KeptGroups;
  return *all;
}

}  // namespace

agnocast_rclcpp::PublisherOptions translate(const agnocast::PublisherOptions& options,
                                            const std::string& topic,
                                            const rclcpp::Logger& logger) {
  warn_of(options.do_always_ros2_publish, "do_always_ros2_publish", topic, logger);
  rclcpp::PublisherOptions ros;
  ros.qos_overriding_options = options.qos_overriding_options;
  agnocast_rclcpp::PublisherOptions translated(ros);
  translated.own.connection_callback(report_connection);
  return translated;
}

agnocast_rclcpp::SubscriptionOptions translate(const agnocast::SubscriptionOptions& options) {
  rclcpp::SubscriptionOptions ros;
  ros.callback_group = options.callback_group;
  ros.ignore_local_publications = options.ignore_local_publications;
  ros.qos_overriding_options = options.qos_overriding_options;
  agnocast_rclcpp::SubscriptionOptions translated(ros);
  if (options.hold_quota != 0) translated.own.hold_quota_or_less(options.hold_quota);
  translated.own.connection_callback(report_connection);
  return translated;
}

void keep_group(const rclcpp::node_interfaces::NodeBaseInterface::SharedPtr& node,
                const rclcpp::CallbackGroup::SharedPtr& group) {
  if (group == nullptr || is_forked_child()) return;
  std::vector<Groups> ended;  // outside the lock
  KeptGroups& kept = kept_groups();
  const std::lock_guard lock(kept.mutex);
  for (auto at = kept.groups.begin(); at != kept.groups.end();) {
    if (at->first.expired()) {
      ended.push_back(std::move(at->second));
      at = kept.groups.erase(at);
    } else {
      ++at;
    }
  }
  kept.groups[node].insert(group);
}

void report_lost_daemon() noexcept {
  report_state(agnocast::connection_state(), agnocast::orphan_reason());
}

rmw_gid_t gid_of(std::uint64_t persistent_id) noexcept {
  rmw_gid_t gid{};  // bytes 12 to 15, the entity id of a DDS guid, are zero, which DDS does not use
  gid.implementation_identifier = "agnocast";
  static_assert(sizeof persistent_id <= RMW_GID_STORAGE_SIZE);
  std::memcpy(gid.data, &persistent_id, sizeof persistent_id);
  return gid;
}

}  // namespace agnocastlib
