// SPDX-License-Identifier: Apache-2.0

#include <agnocast/agnocast_timer.hpp>

#include <agnocastlib/endpoints.hpp>

#include <rclcpp/exceptions.hpp>

#include <rcl/timer.h>

#include <functional>
#include <stdexcept>

namespace agnocast {

TimerBase::TimerBase(rclcpp::Clock::SharedPtr clock) : clock_(std::move(clock)) {
  if (clock_ == nullptr) throw std::invalid_argument("agnocast: a timer needs a clock");
}
TimerBase::~TimerBase() = default;

void TimerBase::start(const SharedPtr& timer, std::chrono::nanoseconds period, bool autostart,
                      const rclcpp::node_interfaces::NodeBaseInterface::SharedPtr& node,
                      const rclcpp::node_interfaces::NodeTimersInterface::SharedPtr& timers,
                      const rclcpp::CallbackGroup::SharedPtr& group) {
  if (period < std::chrono::nanoseconds::zero())
    throw std::invalid_argument("agnocast: the period of a timer is negative");
  std::function<void()> call = [weak = std::weak_ptr<TimerBase>(timer)] {
    if (const SharedPtr alive = weak.lock()) alive->execute_callback();
  };
  timer->timer_ = std::make_shared<rclcpp::GenericTimer<std::function<void()>>>(
      timer->clock_, period, std::move(call), node->get_context());
  agnocastlib::keep_group(node, group);
  if (!autostart) timer->timer_->cancel();
  timers->add_timer(timer->timer_, group);
}

void TimerBase::cancel() { timer_->cancel(); }
bool TimerBase::is_canceled() { return timer_->is_canceled(); }
void TimerBase::reset() { timer_->reset(); }
std::chrono::nanoseconds TimerBase::time_until_trigger() { return timer_->time_until_trigger(); }

void TimerBase::set_period(std::chrono::nanoseconds period) {
  std::int64_t before = 0;
  const rcl_ret_t set = rcl_timer_exchange_period(
      const_cast<rcl_timer_t*>(timer_->get_timer_handle().get()), period.count(), &before);
  if (set != RCL_RET_OK)
    rclcpp::exceptions::throw_from_rcl_error(set, "setting the period of a timer");
}

}  // namespace agnocast
