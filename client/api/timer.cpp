// SPDX-License-Identifier: Apache-2.0

#include <agnocast/timer.hpp>

#include <agnocast/heap.hpp>
#include <client/executors/callback_groups.hpp>
#include <client/process/forked_child.hpp>

#include <algorithm>
#include <atomic>
#include <utility>

namespace agnocast {

class WallTimer::Source final : public CallbackSource {
 public:
  Source(std::chrono::nanoseconds period, std::function<void(WallTimer&)> callback,
         CallbackGroup::SharedPtr group)
      : period_ns_(period.count()), callback_(std::move(callback)), group_(std::move(group)) {
    reset();
  }
  ~Source() override {
    const UserSignals as_creator(signals);
    callback_ = nullptr;
  }
  WallTimer& handle() noexcept { return handle_; }
  /// Ends the callbacks; waits for a running one.
  void end() noexcept { callbacks_->remove(*this, std::exchange(group_, nullptr)); }
  void wake() const noexcept { callbacks_->wake(); }

  bool has_work() const noexcept override {
    const std::int64_t next = next_ns_.load(std::memory_order_acquire);
    return next != never && next <= now_ns();
  }
  Clock::time_point due() const noexcept override {
    const std::int64_t next = next_ns_.load(std::memory_order_acquire);
    return next == never ? Clock::time_point::max()
                         : Clock::time_point(std::chrono::nanoseconds(next));
  }
  bool run_one() override {
    std::int64_t next = next_ns_.load(std::memory_order_acquire);
    for (;;) {
      const std::int64_t now = now_ns();
      if (next == never || now < next) return false;
      const std::int64_t following =
          period_ns_ == 0 ? now : next + ((now - next) / period_ns_ + 1) * period_ns_;
      if (next_ns_.compare_exchange_weak(next, following, std::memory_order_acq_rel)) break;
    }
    callback_(handle_);
    return true;
  }

  void cancel() noexcept { next_ns_.store(never, std::memory_order_release); }
  void reset() noexcept { next_ns_.store(now_ns() + period_ns_, std::memory_order_release); }
  std::int64_t period_ns() const noexcept { return period_ns_; }
  /// Returns the rest of the time; `never` if it is canceled.
  std::int64_t rest_ns() const noexcept {
    const std::int64_t next = next_ns_.load(std::memory_order_acquire);
    return next == never ? never : next - now_ns();
  }

 private:
  static constexpr std::int64_t never = std::chrono::nanoseconds::max().count();
  // The time since boot and the longest period together are less than `never`.
  static std::int64_t now_ns() noexcept {
    return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch())
        .count();
  }

  const std::int64_t period_ns_;
  std::function<void(WallTimer&)> callback_;
  CallbackGroup::SharedPtr group_;  // null: the timer has ended
  const std::shared_ptr<GroupCallbacks> callbacks_ = group_->state().callbacks;
  WallTimer handle_{*this};
  std::atomic<std::int64_t> next_ns_{never};
};

void WallTimer::cancel() noexcept { source_.cancel(); }
bool WallTimer::is_canceled() const noexcept {
  return source_.due() == CallbackSource::Clock::time_point::max();
}
void WallTimer::reset() noexcept {
  source_.reset();
  source_.wake();
}
std::chrono::nanoseconds WallTimer::period() const noexcept {
  return std::chrono::nanoseconds(source_.period_ns());
}
std::chrono::nanoseconds WallTimer::time_until_trigger() const noexcept {
  return std::chrono::nanoseconds(source_.rest_ns());
}
std::uint64_t WallTimer::get_callback_exception_count() const noexcept {
  return source_.exception_count.load(std::memory_order_relaxed);
}

Result<WallTimer::SharedPtr> detail::make_wall_timer(const std::string& node,
                                                     std::chrono::nanoseconds period,
                                                     std::function<void(WallTimer&)> callback,
                                                     const CallbackGroup::SharedPtr& group) {
  if (period.count() < 0)
    return fail(Errc::invalid_argument, "the period of a timer is not from 0 to 285 years");
  const LoanPause pause;
  auto of = callback_groups::of_callback(node, group);
  if (!of) return tl::unexpected<Failure>(of.error());
  GroupCallbacks& callbacks = *(*of)->state().callbacks;  // the source keeps it
  auto source = std::make_shared<WallTimer::Source>(period, std::move(callback), std::move(*of));
  // The source outlives the handle while its callback runs.
  WallTimer::SharedPtr timer(&source->handle(), [source](WallTimer*) { source->end(); });
  callbacks.add(std::move(source));
  return timer;
}

}  // namespace agnocast
