// SPDX-License-Identifier: Apache-2.0
//
// Timers of rclcpp's, with the types of the kernel-module system. They run in any executor that
// runs the node, and follow the ROS clock if they have it.
#pragma once

#include <rclcpp/callback_group.hpp>
#include <rclcpp/clock.hpp>
#include <rclcpp/macros.hpp>
#include <rclcpp/node_interfaces/node_base_interface.hpp>
#include <rclcpp/node_interfaces/node_timers_interface.hpp>
#include <rclcpp/timer.hpp>

#include <chrono>
#include <memory>
#include <type_traits>
#include <utility>

namespace agnocast {

/// Any thread may call any function. The release of the last SharedPtr ends the timer.
class TimerBase {
 public:
  RCLCPP_SMART_PTR_DEFINITIONS_NOT_COPYABLE(TimerBase)

  /// Throws std::invalid_argument: `clock` is null.
  explicit TimerBase(rclcpp::Clock::SharedPtr clock);
  virtual ~TimerBase();
  TimerBase(const TimerBase&) = delete;
  TimerBase& operator=(const TimerBase&) = delete;

  virtual bool is_steady() const { return clock_->get_clock_type() == RCL_STEADY_TIME; }
  virtual rclcpp::Clock::SharedPtr get_clock() const { return clock_; }
  virtual void execute_callback() = 0;

  /// As those of rclcpp::TimerBase. They throw what those throw.
  void cancel();
  bool is_canceled();
  void reset();
  std::chrono::nanoseconds time_until_trigger();
  /// Takes effect after the next callback, or with reset(). Throws rclcpp::exceptions::RCLError.
  void set_period(std::chrono::nanoseconds period);

  /// For the functions that create timers. Adds `timer` to a node; `autostart` false: it does not
  /// run before reset().
  static void start(const SharedPtr& timer, std::chrono::nanoseconds period, bool autostart,
                    const rclcpp::node_interfaces::NodeBaseInterface::SharedPtr& node,
                    const rclcpp::node_interfaces::NodeTimersInterface::SharedPtr& timers,
                    const rclcpp::CallbackGroup::SharedPtr& group);

 private:
  const rclcpp::Clock::SharedPtr clock_;
  rclcpp::TimerBase::SharedPtr timer_;
};

template <class FunctorT>
class GenericTimer : public TimerBase {
 public:
  RCLCPP_SMART_PTR_DEFINITIONS(GenericTimer)
  static_assert(std::is_invocable_v<FunctorT&, TimerBase&> || std::is_invocable_v<FunctorT&>,
                "agnocast: the callback of a timer takes nothing, or agnocast::TimerBase&");

  GenericTimer(rclcpp::Clock::SharedPtr clock, FunctorT callback)
      : TimerBase(std::move(clock)), callback_(std::move(callback)) {}
  void execute_callback() override {
    if constexpr (std::is_invocable_v<FunctorT&, TimerBase&>) {
      callback_(*this);
    } else {
      callback_();
    }
  }

 private:
  FunctorT callback_;
};

/// A timer of the steady clock.
template <class FunctorT>
class WallTimer : public GenericTimer<FunctorT> {
 public:
  RCLCPP_SMART_PTR_DEFINITIONS(WallTimer)

  explicit WallTimer(FunctorT callback)
      : GenericTimer<FunctorT>(std::make_shared<rclcpp::Clock>(RCL_STEADY_TIME),
                               std::move(callback)) {}
};

}  // namespace agnocast
