// SPDX-License-Identifier: Apache-2.0
//
// CallbackGroups: which executor has which callback group of this process.
//
// Groups and the claims of executors are found by the node's fully qualified name: a node may be
// added to an executor before or after its first endpoint, and any type of node fits. All changes
// of executor go through here, under one mutex, so that a group has one executor at any time. (A
// CallbackIsolatedExecutor moves its groups between cores of its own, which is not seen here.)
//
// A group that no executor has is run by nobody; its messages stay unread.
//
// Groups have wait sets of their own while there are enough; then they share. A ring on a shared
// one wakes the executors of all its groups, which costs time and nothing else.
#pragma once

#include <agnocast/callback_group.hpp>
#include <agnocast/result.hpp>
#include <client/executors/group_callbacks.hpp>

#include <memory>
#include <string>

namespace agnocast {

/// What takes over groups: an executor. Called under the mutex of CallbackGroups.
class GroupExecutor {
 public:
  virtual ~GroupExecutor() = default;
  /// Errors: os_failure.
  [[nodiscard]] virtual Result<void> adopt(const std::shared_ptr<GroupCallbacks>& group) = 0;
  [[nodiscard]] virtual Result<void> listen(const GroupCallbacks& group,
                                            std::shared_ptr<WaitSet> wait_set) = 0;
  virtual void drop(GroupCallbacks& group) noexcept = 0;
};

struct CallbackGroup::State {
  State(const std::string& node, CallbackGroupType type, bool with_node, const std::string& name);

  const bool is_with_node;
  const std::shared_ptr<GroupCallbacks> callbacks;  // running callbacks keep it as well
  // Under the mutex of CallbackGroups:
  GroupExecutor* executor = nullptr;
  bool is_added_alone = false;  // by add_callback_group()
};

namespace callback_groups {

/// Returns the group of a new callback of `node`: `named`, or the node's default group, which is
/// made with its first callback and ends with its last. Errors: invalid_argument (a group of
/// another node), os_failure.
[[nodiscard]] Result<CallbackGroup::SharedPtr> of_callback(const std::string& node,
                                                           const CallbackGroup::SharedPtr& named);
/// The same with a wait set, which the endpoint announces. Errors: also limit_reached (no wait
/// set), and those of connecting.
[[nodiscard]] Result<CallbackGroup::SharedPtr> of_endpoint(const std::string& node,
                                                           const CallbackGroup::SharedPtr& named);

/// Makes `executor` run the groups of this node, present and future ones that belong with it and
/// are in no executor. Errors: invalid_argument (an executor has the node already), os_failure.
[[nodiscard]] Result<void> claim_node(const std::string& node, GroupExecutor& executor);
/// Errors: invalid_argument (the node is not with this executor).
[[nodiscard]] Result<void> release_node(const std::string& node, GroupExecutor& executor);
/// The same for one group.
[[nodiscard]] Result<void> claim_group(CallbackGroup& group, GroupExecutor& executor);
[[nodiscard]] Result<void> release_group(CallbackGroup& group, GroupExecutor& executor);
/// Releases everything of an executor that ends.
void release_all(GroupExecutor& executor) noexcept;

}  // namespace callback_groups
}  // namespace agnocast
