// SPDX-License-Identifier: Apache-2.0
//
// GroupWaitable: the callbacks of one adapted group, as rclcpp's executors see them.
//
// rclcpp prepares a wait set before each wait, and leaves busy exclusive groups out of it. So
// add_to_wait_set() looks: if there is something to do, it triggers the guard condition at once,
// otherwise it arms the descriptor for GuardThread. A trigger may be consumed by a wait that has
// left this group out, so is_ready() looks as well and never asks the guard condition.
//
// After a wait, rclcpp's executors call each waitable once, and each subscription once. So that one
// call of spin_some() means as much for a group here, each endpoint but the first adds a
// FurtherWaitable, which lets the executor call the group once more. Each call serves the ready
// endpoint that was served longest ago, so none is called twice while another one waits.
#pragma once

#include <agnocast/callback_group.hpp>
#include <agnocast/callback_group_waitable.hpp>

#include <rclcpp/version.h>
#include <rclcpp/guard_condition.hpp>
#include <rclcpp/waitable.hpp>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <utility>

namespace agnocast_rclcpp {

// What rclcpp::Waitable's functions take, which Jazzy changed.
#if RCLCPP_VERSION_MAJOR < 28
using WaitSet = rcl_wait_set_t*;
using ReadyWaitSet = rcl_wait_set_t*;
using WaitableData = std::shared_ptr<void>&;
#else
using WaitSet = rcl_wait_set_t&;
using ReadyWaitSet = const rcl_wait_set_t&;
using WaitableData = const std::shared_ptr<void>&;
#endif

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
  void add_to_wait_set(WaitSet wait_set) override;
  bool is_ready(ReadyWaitSet) override { return take_one(); }
  std::shared_ptr<void> take_data() override { return nullptr; }
  std::shared_ptr<void> take_data_by_entity_id(std::size_t) override { return nullptr; }
  void execute(WaitableData data) override;
  void set_on_ready_callback(std::function<void(std::size_t, int)> callback) override;
  void clear_on_ready_callback() override;

  /// Returns whether a callback is left of those that could begin when the first one asked after
  /// the wait; this one or a FurtherWaitable, as the executor orders them.
  bool take_one() noexcept;

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
  std::atomic<bool> is_counted_{false};
  std::atomic<std::int64_t> left_{0};
  std::mutex mutex_;
  std::function<void(std::size_t, int)> on_ready_;  // of an events executor
};

/// Lets an executor call a group once more after each wait.
class FurtherWaitable final : public rclcpp::Waitable {
 public:
  explicit FurtherWaitable(std::shared_ptr<GroupWaitable> group) noexcept
      : group_(std::move(group)) {}

  void add_to_wait_set(WaitSet) override {}
  bool is_ready(ReadyWaitSet) override { return group_->take_one(); }
  std::shared_ptr<void> take_data() override { return nullptr; }
  std::shared_ptr<void> take_data_by_entity_id(std::size_t) override { return nullptr; }
  void execute(WaitableData data) override { group_->execute(data); }
  /// Nothing: an events executor calls the group until it has no work.
  void set_on_ready_callback(std::function<void(std::size_t, int)>) override {}
  void clear_on_ready_callback() override {}

 private:
  const std::shared_ptr<GroupWaitable> group_;
};

}  // namespace agnocast_rclcpp
