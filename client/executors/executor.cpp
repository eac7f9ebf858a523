// SPDX-License-Identifier: Apache-2.0
//
// The public part of executors: how long to run callbacks, how long to poll, when to sleep.

#include <agnocast/executor.hpp>
#include <client/executors/executor_state.hpp>
#include <client/process/forked_child.hpp>

#include <algorithm>
#include <atomic>
#include <optional>
#include <utility>

namespace agnocast {
namespace {

using Clock = ExecutorCore::Clock;

// Interval of checking a future that another thread fulfils.
constexpr std::chrono::milliseconds future_look{10};
// Checks between two readings of the clock.
constexpr int looks_per_clock = 16;

void pause_core() noexcept {
#if defined(__x86_64__)
  __builtin_ia32_pause();
#elif defined(__aarch64__)
  asm volatile("yield" ::: "memory");
#endif
}

/// Returns the time after `duration`; for a negative one, never.
Clock::time_point after(std::chrono::nanoseconds duration) noexcept {
  const Clock::time_point now = Clock::now();
  if (duration < std::chrono::nanoseconds(0) || duration >= Clock::time_point::max() - now)
    return Clock::time_point::max();
  return now + std::chrono::duration_cast<Clock::duration>(duration);
}
Clock::time_point bound_of(std::chrono::nanoseconds max_duration) noexcept {
  return max_duration > std::chrono::nanoseconds(0) ? after(max_duration)
                                                    : Clock::time_point::max();
}

/// Returns whether the deadline is over; without one it does not read the clock.
bool is_over(Clock::time_point deadline) noexcept {
  return deadline != Clock::time_point::max() && Clock::now() >= deadline;
}

/// Returns the time until `deadline`, rounded up so that a sleep does not end just before it;
/// nothing if the executor's own tick comes first.
std::optional<std::chrono::milliseconds> time_until(Clock::time_point deadline) noexcept {
  if (deadline == Clock::time_point::max()) return std::nullopt;
  const Clock::time_point now = Clock::now();
  if (deadline <= now) return std::chrono::milliseconds(0);
  if (deadline - now >= SleepTick::period) return std::nullopt;
  return std::chrono::ceil<std::chrono::milliseconds>(deadline - now);
}

}  // namespace

Executor::Executor(std::unique_ptr<State> state) noexcept : state_(state.release()) {}

Executor::Executor(std::chrono::nanoseconds spin_budget)
    : Executor(std::make_unique<State>(State::make_core(), spin_budget)) {}

Executor::~Executor() {
  callback_groups::release_all(state_->groups());
  // exit() in a callback destroys an executor with static storage while its threads are in there,
  // and a forked child has copies of what its parent's threads use.
  if (!is_forked_child() && !state_->is_spinning.load(std::memory_order_acquire)) delete state_;
}

void Executor::add_node_of_name(const std::string& node) {
  if (Result<void> claimed = callback_groups::claim_node(node, state_->groups()); !claimed)
    throw Error(claimed.error());
}

void Executor::remove_node_of_name(const std::string& node) {
  if (Result<void> released = callback_groups::release_node(node, state_->groups()); !released)
    throw Error(released.error());
}

void Executor::add_callback_group(const CallbackGroup::SharedPtr& group) {
  if (Result<void> claimed = callback_groups::claim_group(*group, state_->groups()); !claimed)
    throw Error(claimed.error());
}

void Executor::remove_callback_group(const CallbackGroup::SharedPtr& group) {
  if (Result<void> released = callback_groups::release_group(*group, state_->groups()); !released)
    throw Error(released.error());
}

void Executor::cancel() noexcept {
  if (!is_forked_child()) state_->core->cancel();  // it would wake the parent's executor
}
bool Executor::is_spinning() const noexcept { return state_->spins(); }

/// Returns false at `deadline` or when cancelled. True may be wrong: the caller checks for work.
bool Executor::wait_for_work(Clock::time_point deadline) {
  ExecutorCore& core = *state_->core;
  if (state_->spin_budget > std::chrono::nanoseconds(0)) {
    const Clock::time_point end = std::min(after(state_->spin_budget), deadline);
    do {
      for (int i = 0; i < looks_per_clock; ++i) {
        if (core.is_cancelled()) return false;
        if (core.has_work()) return true;
        pause_core();
      }
    } while (Clock::now() < end);
  }
  if (core.is_cancelled() || is_over(deadline)) return false;
  core.wait(time_until(deadline));
  return !core.is_cancelled();
}

void Executor::spin() {
  const Spinning spinning(*state_);
  while (!state_->core->take_cancel()) {
    if (!state_->core->run_next()) wait_for_work(Clock::time_point::max());
  }
}

void Executor::spin_some(std::chrono::nanoseconds max_duration) {
  const Spinning spinning(*state_);
  if (!state_->core->take_cancel()) state_->core->run_cycle(bound_of(max_duration));
}

void Executor::spin_all(std::chrono::nanoseconds max_duration) {
  const Spinning spinning(*state_);
  const Clock::time_point deadline = bound_of(max_duration);
  while (!state_->core->take_cancel() && state_->core->run_cycle(deadline) != 0) {
  }
}

void Executor::spin_once(std::chrono::nanoseconds timeout) {
  const Spinning spinning(*state_);
  const Clock::time_point deadline = after(timeout);
  while (!state_->core->take_cancel()) {
    if (state_->core->run_next() || Clock::now() >= deadline) return;
    wait_for_work(deadline);
  }
}

FutureReturnCode Executor::spin_until(bool (*is_ready)(const void*), const void* future,
                                      std::chrono::nanoseconds timeout) {
  const Spinning spinning(*state_);
  const Clock::time_point deadline = after(timeout);
  for (;;) {
    if (is_ready(future)) return FutureReturnCode::SUCCESS;
    if (state_->core->take_cancel()) return FutureReturnCode::INTERRUPTED;
    if (Clock::now() >= deadline) return FutureReturnCode::TIMEOUT;
    if (!state_->core->run_next()) wait_for_work(std::min(deadline, after(future_look)));
  }
}

int Executor::fd() const noexcept { return state_->core->fd(); }

Executor::Readiness Executor::prepare() noexcept {
  return !is_forked_child() && state_->core->prepare() ? Readiness::work_ready : Readiness::armed;
}

std::size_t Executor::dispatch() {
  const Spinning spinning(*state_);
  struct Ending {
    ExecutorCore& core;
    ~Ending() {
      if (!is_forked_child()) core.end_dispatch();
    }
  };
  const Ending ending{*state_->core};
  state_->core->finish_sleep();
  if (state_->core->take_cancel()) return 0;
  return state_->core->run_cycle(Clock::time_point::max());
}

}  // namespace agnocast
