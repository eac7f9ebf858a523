// SPDX-License-Identifier: Apache-2.0

#include <client/executors/background_thread.hpp>
#include <client/executors/executor_state.hpp>

#include <memory>
#include <utility>

namespace agnocast {
namespace {

struct BackgroundState final : Executor::State {
  BackgroundState() : State(make_core(), std::chrono::nanoseconds(0)) {
    auto started = BackgroundThread::start(core);
    if (!started) throw Error(started.error());
    thread = std::move(*started);
    is_spinning.store(true, std::memory_order_release);
  }
  bool spins() const noexcept override { return !is_forked_child() && !thread->has_ended(); }

  std::shared_ptr<BackgroundThread> thread;
};

}  // namespace

BackgroundExecutor::BackgroundExecutor() : Executor(std::make_unique<BackgroundState>()) {}

BackgroundExecutor::~BackgroundExecutor() {
  if (is_forked_child()) return;
  static_cast<BackgroundState&>(state()).thread->join();
  state().is_spinning.store(false, std::memory_order_release);
}

}  // namespace agnocast
