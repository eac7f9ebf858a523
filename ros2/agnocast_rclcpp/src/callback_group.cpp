// SPDX-License-Identifier: Apache-2.0

#include <agnocast/connection_state.hpp>
#include <agnocast/error.hpp>
#include <agnocast/heap.hpp>
#include <agnocast_rclcpp/callback_group.hpp>

#include "group_waitable.hpp"
#include "guard_thread.hpp"

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <system_error>
#include <utility>

namespace agnocast_rclcpp {
namespace {

using NodeBase = rclcpp::node_interfaces::NodeBaseInterface;
using NodeWaitables = rclcpp::node_interfaces::NodeWaitablesInterface;

/// A group of agnocast's, and how rclcpp runs it. Endpoints share it.
struct AdaptedGroup {
  ~AdaptedGroup();
  void remove(const std::shared_ptr<rclcpp::Waitable>& removed) const {
    const auto base = node.lock();
    const auto from = waitables.lock();
    const auto in = rclcpp_group.lock();
    if (base != nullptr && from != nullptr && in != nullptr) from->remove_waitable(removed, in);
  }

  agnocast::CallbackGroup::SharedPtr group;
  std::shared_ptr<GroupWaitable> waitable;
  std::weak_ptr<NodeBase> node;  // NodeWaitables refers to it
  std::weak_ptr<NodeWaitables> waitables;
  std::weak_ptr<rclcpp::CallbackGroup> rclcpp_group;
};

/// What an endpoint has of a group that another endpoint had before it.
struct FurtherEndpoint {
  ~FurtherEndpoint() {
    if (GuardThread::instance().is_here()) group->remove(waitable);
  }

  std::shared_ptr<AdaptedGroup> group;
  std::shared_ptr<FurtherWaitable> waitable;
};

struct Groups {
  std::mutex mutex;
  // The control block of a key lives as long as the key, so no other group is mistaken for it.
  std::map<std::weak_ptr<rclcpp::CallbackGroup>, std::weak_ptr<AdaptedGroup>,
           std::owner_less<std::weak_ptr<rclcpp::CallbackGroup>>>
      adapted;
};
Groups& groups() {
  static Groups* const all = new Groups;  // for endpoints in statics
  return *all;
}

AdaptedGroup::~AdaptedGroup() {
  if (!GuardThread::instance().is_here()) {
    // Threads of the parent may hold the locks here and of the guard condition.
    (void)new std::shared_ptr<GroupWaitable>(std::move(waitable));
    return;
  }
  {
    Groups& all = groups();
    const std::lock_guard lock(all.mutex);
    const auto found = all.adapted.find(rclcpp_group);
    // Another thread may have adapted the group anew meanwhile.
    if (found != all.adapted.end() && found->second.expired()) all.adapted.erase(found);
  }
  if (waitable == nullptr) return;
  waitable->leave();
  remove(waitable);
}

/// Throws agnocast::Error (os_failure), std::system_error and what rclcpp throws.
agnocast::CallbackGroup::SharedPtr share_group(const NodeBase::SharedPtr& node,
                                               const NodeWaitables::SharedPtr& waitables,
                                               const rclcpp::CallbackGroup::SharedPtr& group) {
  std::shared_ptr<AdaptedGroup> adapted;  // outside the lock: its destructor takes it
  Groups& all = groups();
  const std::lock_guard lock(all.mutex);
  const auto found = all.adapted.find(group);
  if (found != all.adapted.end()) adapted = found->second.lock();
  if (adapted == nullptr) {
    adapted = std::make_shared<AdaptedGroup>();
    const auto type = group->type() == rclcpp::CallbackGroupType::Reentrant
                          ? agnocast::CallbackGroupType::Reentrant
                          : agnocast::CallbackGroupType::MutuallyExclusive;
    const bool is_default = group == node->get_default_callback_group();
    adapted->group = agnocast::detail::make_callback_group(node->get_fully_qualified_name(), type,
                                                           false, is_default ? "default" : "");
    adapted->waitable = GroupWaitable::make(node->get_context(), *adapted->group);
    adapted->node = node;
    adapted->waitables = waitables;
    adapted->rclcpp_group = group;
    waitables->add_waitable(adapted->waitable, group);  // refuses a group of another node
    // An executor that already spins watches the groups that it has, and finds new ones when it is
    // woken: Humble's does not watch the condition of the node.
    node->get_default_callback_group()->trigger_notify_guard_condition();
    all.adapted[group] = adapted;
    return {adapted, adapted->group.get()};
  }
  auto further = std::make_shared<FurtherEndpoint>();
  further->group = adapted;
  further->waitable = std::make_shared<FurtherWaitable>(adapted->waitable);
  waitables->add_waitable(further->waitable, group);
  return {further, adapted->group.get()};
}

}  // namespace

agnocast::Result<agnocast::CallbackGroup::SharedPtr> adapt_group(
    const NodeBase::SharedPtr& node, const NodeWaitables::SharedPtr& waitables,
    rclcpp::CallbackGroup::SharedPtr group) {
  const agnocast::LoanPause pause;  // what it makes outlives any loan of this thread
  // Throws as rclcpp does, also for a group that has endpoints already.
  if (!node->get_context()->is_valid()) rclcpp::GuardCondition after_shutdown(node->get_context());
  if (group == nullptr) group = node->get_default_callback_group();
  try {
    if (!GuardThread::instance().is_here())
      return tl::unexpected<agnocast::Failure>(
          agnocast::Failure{agnocast::Errc::shut_down, 0, "this is a forked child"});
    return share_group(node, waitables, group);
  } catch (const agnocast::Error& error) {
    return tl::unexpected<agnocast::Failure>(error.failure());
  } catch (const std::system_error& error) {
    return tl::unexpected<agnocast::Failure>(agnocast::Failure{
        agnocast::Errc::os_failure, error.code().value(), "adapting a callback group"});
  }
}

}  // namespace agnocast_rclcpp
