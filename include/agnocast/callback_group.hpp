// SPDX-License-Identifier: Apache-2.0
//
// CallbackGroup: which callbacks of a node may run at the same time, and in which executor. Every
// node has a default group, mutually exclusive, for all that names none. See docs/nodes.md.
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/node_like.hpp>

#include <cstdint>
#include <memory>
#include <string>

namespace agnocast {

/// As rclcpp::CallbackGroupType.
enum class CallbackGroupType : std::uint8_t {
  MutuallyExclusive,  ///< one callback at a time
  Reentrant,          ///< any number, also of one subscription, in as many threads
};

/// Made by create_callback_group(). A group belongs to one node and is in one executor at most.
/// Endpoints keep the groups that they name. Any thread may call any function.
class AGNOCAST_PUBLIC CallbackGroup {
 public:
  using SharedPtr = std::shared_ptr<CallbackGroup>;
  struct State;  // the library's

  explicit CallbackGroup(std::unique_ptr<State> state) noexcept;
  /// Leaves its executor.
  ~CallbackGroup();
  CallbackGroup(const CallbackGroup&) = delete;
  CallbackGroup& operator=(const CallbackGroup&) = delete;

  CallbackGroupType type() const noexcept;
  /// Returns "default" for the default group of a node; empty: it was made without a name.
  const std::string& name() const noexcept;
  /// False: Executor::add_node() leaves this group out; add_callback_group() adds it.
  bool automatically_add_to_executor_with_node() const noexcept;
  State& state() const noexcept { return *state_; }

 private:
  const std::unique_ptr<State> state_;
};

namespace detail {

AGNOCAST_PUBLIC CallbackGroup::SharedPtr make_callback_group(const std::string& node,
                                                             CallbackGroupType type, bool with_node,
                                                             const std::string& name);

/// Setter of the options of publishers and subscriptions.
template <class Options>
class CallbackGroupOption {
 public:
  /// Callbacks of messages and events run in this group of the node; null: its default group.
  /// Creation refuses a group of another node (invalid_argument).
  Options& callback_group(CallbackGroup::SharedPtr group) noexcept {
    return group_ = std::move(group), static_cast<Options&>(*this);
  }
  const CallbackGroup::SharedPtr& callback_group() const noexcept { return group_; }

 protected:
  CallbackGroup::SharedPtr group_;
};

}  // namespace detail

/// Creates a callback group of `node` (by reference or pointer). `name`: how thread rules of
/// agnocastd and `agnocast-ctl thread list` call it; several groups may share a name. Throws Error:
/// shut_down (in a forked child).
template <class Node>
CallbackGroup::SharedPtr create_callback_group(Node&& node, CallbackGroupType type,
                                               bool automatically_add_to_executor_with_node = true,
                                               const std::string& name = {}) {
  static_assert(!detail::is_rclcpp_node<detail::NodeOf<Node>>,
                "agnocast: an rclcpp node makes rclcpp's callback groups");
  return detail::make_callback_group(detail::dereference(node).get_fully_qualified_name(), type,
                                     automatically_add_to_executor_with_node, name);
}

}  // namespace agnocast
