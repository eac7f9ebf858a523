// SPDX-License-Identifier: Apache-2.0
//
// Executor::State: what an executor has besides its public part.
#pragma once

#include <agnocast/executor.hpp>
#include <agnocast/heap.hpp>
#include <client/executors/callback_groups.hpp>
#include <client/executors/executor_core.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/preparation.hpp>
#include <client/process/user_code.hpp>

#include <atomic>
#include <chrono>
#include <memory>
#include <utility>

namespace agnocast {

/// Its groups all go to one core.
class CoreGroups : public GroupExecutor {
 public:
  explicit CoreGroups(ExecutorCore& core) noexcept : core_(core) {}
  Result<void> adopt(const std::shared_ptr<GroupCallbacks>& group) override {
    return core_.adopt(group);
  }
  Result<void> listen(const GroupCallbacks& group, std::shared_ptr<WaitSet> wait_set) override {
    return core_.listen(group, std::move(wait_set));
  }
  void drop(GroupCallbacks& group) noexcept override { core_.drop(group); }

 private:
  ExecutorCore& core_;
};

struct Executor::State {
  /// Throws Error: shut_down (in a forked child), os_failure.
  static std::shared_ptr<ExecutorCore> make_core() {
    if (Result<void> refused = refuse_forked_child(); !refused) throw Error(refused.error());
    if (Result<void> refused = refuse_after_exit(); !refused) throw Error(refused.error());
    if (Result<void> prepared = prepare_process(); !prepared) throw Error(prepared.error());
    const LoanPause pause;  // it outlives any loan of this thread
    auto core = ExecutorCore::make();
    if (!core) throw Error(core.error());
    return std::move(*core);
  }
  State(std::shared_ptr<ExecutorCore> made, std::chrono::nanoseconds budget) noexcept
      : core(std::move(made)), core_groups(*core), spin_budget(budget) {}
  virtual ~State() = default;
  virtual GroupExecutor& groups() noexcept { return core_groups; }
  virtual bool spins() const noexcept { return is_spinning.load(std::memory_order_acquire); }

  const std::shared_ptr<ExecutorCore> core;
  CoreGroups core_groups;
  const std::chrono::nanoseconds spin_budget;
  std::atomic<bool> is_spinning{false};
};

/// Allows one spin function at a time.
class Executor::Spinning {
 public:
  explicit Spinning(State& state) : state_(state) {
    if (Result<void> refused = refuse_forked_child(); !refused) throw Error(refused.error());
    if (state_.is_spinning.exchange(true, std::memory_order_acq_rel))
      throw Error({Errc::invalid_argument, 0, "this executor is spinning already"});
  }
  ~Spinning() { state_.is_spinning.store(false, std::memory_order_release); }
  Spinning(const Spinning&) = delete;
  Spinning& operator=(const Spinning&) = delete;

 private:
  State& state_;
};

}  // namespace agnocast
