// SPDX-License-Identifier: Apache-2.0

#include "group_waitable.hpp"

#include "guard_thread.hpp"

#include <rclcpp/exceptions.hpp>

#include <exception>
#include <stdexcept>
#include <utility>

namespace agnocast_rclcpp {
namespace {

[[maybe_unused]] rcl_wait_set_t* address_of(rcl_wait_set_t* wait_set) noexcept { return wait_set; }
[[maybe_unused]] rcl_wait_set_t* address_of(rcl_wait_set_t& wait_set) noexcept { return &wait_set; }

}  // namespace

std::shared_ptr<GroupWaitable> GroupWaitable::make(const rclcpp::Context::SharedPtr& context,
                                                   agnocast::CallbackGroup& group) {
  auto made = std::make_shared<GroupWaitable>(context, group);
  GuardThread::instance().add(made->number_, made, made->callbacks_.fd());
  return made;
}

GroupWaitable::GroupWaitable(const rclcpp::Context::SharedPtr& context,
                             agnocast::CallbackGroup& group)
    : context_(context),
      callbacks_(group),
      guard_(context),
      number_(GuardThread::instance().next_number()) {}

void GroupWaitable::leave() noexcept { GuardThread::instance().remove(number_, callbacks_.fd()); }

bool GroupWaitable::prepare() noexcept {
  if (is_over()) return false;
  if (callbacks_.prepare()) return true;
  GuardThread::instance().arm(number_, callbacks_.fd());
  return false;
}

void GroupWaitable::tell() noexcept {
  try {
    {
      const std::lock_guard lock(mutex_);
      if (on_ready_) return on_ready_(1, 0);
    }
    guard_.trigger();
  } catch (const std::exception&) {
    // The context was shut down: nobody waits any more.
  }
}

void GroupWaitable::ring() noexcept {
  if (prepare()) tell();
}

void GroupWaitable::add_to_wait_set(WaitSet wait_set) {
  is_counted_.store(false, std::memory_order_relaxed);
  if (prepare()) tell();
  const rcl_ret_t added = rcl_wait_set_add_guard_condition(
      address_of(wait_set), &guard_.get_rcl_guard_condition(), nullptr);
  if (added != RCL_RET_OK)
    rclcpp::exceptions::throw_from_rcl_error(added, "adding agnocast's guard condition");
}

bool GroupWaitable::take_one() noexcept {
  if (!is_counted_.exchange(true, std::memory_order_relaxed)) {
    const std::size_t count = is_over() ? 0 : callbacks_.ready_count();
    left_.store(static_cast<std::int64_t>(count), std::memory_order_relaxed);
  }
  return left_.fetch_sub(1, std::memory_order_relaxed) > 0;
}

void GroupWaitable::execute(WaitableData) {
  // An events executor does not wait again, so it must be notified of the rest.
  struct Telling {
    GroupWaitable& self;
    ~Telling() {
      if (!GuardThread::instance().is_here()) return;  // a thread of the parent may have the mutex
      bool has_events_executor = false;
      {
        const std::lock_guard lock(self.mutex_);
        has_events_executor = self.on_ready_ != nullptr;
      }
      if (has_events_executor) self.ring();
    }
  };
  if (is_over()) return;  // since is_ready()
  const Telling telling{*this};
  (void)callbacks_.run_one();
}

void GroupWaitable::set_on_ready_callback(std::function<void(std::size_t, int)> callback) {
  if (!callback)
    throw std::invalid_argument("the callback of set_on_ready_callback is not callable");
  {
    const std::lock_guard lock(mutex_);
    on_ready_ = std::move(callback);
  }
  ring();
}

void GroupWaitable::clear_on_ready_callback() {
  const std::lock_guard lock(mutex_);
  on_ready_ = nullptr;
}

}  // namespace agnocast_rclcpp
