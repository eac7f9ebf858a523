// SPDX-License-Identifier: Apache-2.0
//
// Wall timers: callbacks at a steady rate, in the executor of their callback group like those of
// messages. See docs/nodes.md.
#pragma once

#include <agnocast/callback_group.hpp>
#include <agnocast/core_namespace.hpp>
#include <agnocast/exceptions.hpp>
#include <agnocast/export.hpp>
#include <agnocast/node_like.hpp>
#include <agnocast/result.hpp>

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

namespace agnocast {

AGNOCAST_CORE_BEGIN

/// Made by create_wall_timer(). Times are those of std::chrono::steady_clock. The n-th callback is
/// due n periods after the creation or the last reset(): delays do not add up. Periods that are
/// over when a callback begins get none of their own. Any thread may call any function, also from
/// the callback. The release of the last SharedPtr ends the timer; it waits for a running callback,
/// unless that is where it happens. Needs no daemon.
class AGNOCAST_PUBLIC WallTimer {
 public:
  using SharedPtr = std::shared_ptr<WallTimer>;
  class Source;  // the library's

  explicit WallTimer(Source& source) noexcept : source_(source) {}
  WallTimer(const WallTimer&) = delete;
  WallTimer& operator=(const WallTimer&) = delete;

  /// No callback begins until reset().
  void cancel() noexcept;
  bool is_canceled() const noexcept;
  /// The next callback is due in one period from now.
  void reset() noexcept;
  std::chrono::nanoseconds period() const noexcept;
  /// Negative: it has been due for so long. The largest value: it is canceled.
  std::chrono::nanoseconds time_until_trigger() const noexcept;
  /// Returns how many exceptions of its callback had no receiver: see docs/nodes.md.
  std::uint64_t get_callback_exception_count() const noexcept;

 private:
  Source& source_;  // of which it is a part
};

AGNOCAST_CORE_END

namespace detail {

[[nodiscard]] AGNOCAST_PUBLIC Result<core::WallTimer::SharedPtr> make_wall_timer(
    const std::string& node, std::chrono::nanoseconds period,
    std::function<void(core::WallTimer&)> callback, const CallbackGroup::SharedPtr& group);

}  // namespace detail

AGNOCAST_CORE_BEGIN

/// Creates a timer of `node` (by reference or pointer) that calls `callback`, which takes nothing
/// or the WallTimer&, in `group` of that node (null: its default group). A period of 0: once in
/// each executor cycle. Errors: invalid_argument (a negative period or one of centuries, a group
/// of another node), shut_down (in a forked child), os_failure.
template <class Node, class Rep, class Period, class Callback>
[[nodiscard]] Result<WallTimer::SharedPtr> try_create_wall_timer(
    Node&& node, std::chrono::duration<Rep, Period> period, Callback&& callback,
    const CallbackGroup::SharedPtr& group = nullptr) {
  static_assert(!detail::is_rclcpp_node<detail::NodeOf<Node>>,
                "agnocast: an rclcpp node makes rclcpp's timers");
  constexpr bool takes_timer = std::is_invocable_v<Callback&, WallTimer&>;
  static_assert(takes_timer || std::is_invocable_v<Callback&>,
                "agnocast: the callback of a timer takes nothing, or agnocast::WallTimer&");
  // In floating point, which does not overflow.
  constexpr double longest_s = 9e9;
  const double seconds = std::chrono::duration<double>(period).count();
  const auto whole = seconds >= 0 && seconds < longest_s
                         ? std::chrono::duration_cast<std::chrono::nanoseconds>(period)
                         : std::chrono::nanoseconds(-1);
  const std::string name = detail::dereference(node).get_fully_qualified_name();
  if constexpr (takes_timer) {
    return detail::make_wall_timer(name, whole, std::forward<Callback>(callback), group);
  } else {
    return detail::make_wall_timer(
        name, whole, [call = std::forward<Callback>(callback)](WallTimer&) mutable { call(); },
        group);
  }
}

/// The same; throws Error.
template <class Node, class Rep, class Period, class Callback>
WallTimer::SharedPtr create_wall_timer(Node&& node, std::chrono::duration<Rep, Period> period,
                                       Callback&& callback,
                                       const CallbackGroup::SharedPtr& group = nullptr) {
  auto timer = try_create_wall_timer(node, period, std::forward<Callback>(callback), group);
  if (!timer) throw Error(timer.error());
  return std::move(*timer);
}

AGNOCAST_CORE_END

}  // namespace agnocast
