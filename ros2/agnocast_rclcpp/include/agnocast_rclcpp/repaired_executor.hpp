// SPDX-License-Identifier: Apache-2.0
//
// RepairedExecutor: an executor of rclcpp's in which a defect of Humble's is mostly mended. When a
// node with several callback groups is removed, Humble's executors keep pointers to conditions of
// these groups, and throw (RCLError, "guard condition implementation is invalid") once the groups
// have ended: for instance when such a component is unloaded. This one removes the pointers. A
// thread that is already inside rcl_wait() may still have the condition until it wakes, so keep the
// groups of a removed node until then.
#pragma once

#include <rclcpp/version.h>
#include <rclcpp/executor.hpp>

namespace agnocast_rclcpp {

template <class Executor>
class RepairedExecutor : public Executor {
 public:
  using Executor::Executor;

#if RCLCPP_VERSION_MAJOR < 28
 protected:
  void remove_callback_group_from_map(
      rclcpp::CallbackGroup::SharedPtr group_ptr,
      rclcpp::memory_strategy::MemoryStrategy::WeakCallbackGroupsToNodesMap& weak_groups_to_nodes,
      bool notify = true) override {
    Executor::remove_callback_group_from_map(group_ptr, weak_groups_to_nodes, notify);
    const auto left = this->weak_groups_to_guard_conditions_.find(group_ptr);
    if (left == this->weak_groups_to_guard_conditions_.end()) return;
    this->memory_strategy_->remove_guard_condition(left->second);
    this->weak_groups_to_guard_conditions_.erase(left);
  }
#endif
};

}  // namespace agnocast_rclcpp
