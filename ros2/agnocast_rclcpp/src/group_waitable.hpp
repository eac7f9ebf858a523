// SPDX-License-Identifier: Apache-2.0
//
// GroupWaitable: the callbacks of one adapted group, as rclcpp's executors see them.
//
// rclcpp prepares a wait set before each wait, and leaves busy exclusive groups out of it. So
// add_to_wait_set() looks: if there is something to do, it triggers the guard condition at once,
// otherwise it arms the descriptor for GuardThread. A trigger may be consumed by a wait that has
// left this group out, so is_ready() looks as well and never asks the guard condition.
#pragma once

#include <agnocast/callback_group.hpp>
#include <agnocast/callback_group_waitable.hpp>

#include <rclcpp/guard_condition.hpp>
#include <rclcpp/waitable.hpp>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>

namespace agnocast_rclcpp {

class GroupWaitable final : public rclcpp::Waitable {
 public:
  /// Throws agnocast::Error, and what rclcpp throws for a context that was shut down.
  static std::shared_ptr<GroupWaitable> make(const rclcpp::Context::SharedPtr& context,
                                             agnocast::CallbackGroup& group);
  GroupWaitable(const rclcpp::Context::SharedPtr& context, agnocast::CallbackGroup& group);
  /// Ends ring().
  void leave() noexcept;

  /// Called by GuardThread when the descriptor is readable.
  void ring() noexcept;

  std::size_t get_number_of_ready_guard_conditions() override { return 1; }
  void add_to_wait_set(rcl_wait_set_t* wait_set) override;
  bool is_ready(rcl_wait_set_t* wait_set) override;
  std::shared_ptr<void> take_data() override { return nullptr; }
  std::shared_ptr<void> take_data_by_entity_id(std::size_t) override { return nullptr; }
  void execute(std::shared_ptr<void>& data) override;
  void set_on_ready_callback(std::function<void(std::size_t, int)> callback) override;
  void clear_on_ready_callback() override;

 private:
  /// Returns true if there is something to do; otherwise ring() comes later.
  bool prepare() noexcept;
  void tell() noexcept;
  /// Returns whether the context was shut down; then no callback begins.
  bool is_over() const noexcept { return !context_->is_valid(); }

  const rclcpp::Context::SharedPtr context_;
  agnocast::CallbackGroupWaitable callbacks_;
  rclcpp::GuardCondition guard_;
  const std::uint64_t number_;  // of GuardThread, which may ring as soon as it knows the group
  std::mutex mutex_;
  std::function<void(std::size_t, int)> on_ready_;  // of an events executor
};

}  // namespace agnocast_rclcpp
