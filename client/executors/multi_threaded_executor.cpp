// SPDX-License-Identifier: Apache-2.0

#include <client/executors/executor_state.hpp>
#include <client/executors/spinning_threads.hpp>

#include <algorithm>
#include <atomic>
#include <thread>

namespace agnocast {

MultiThreadedExecutor::MultiThreadedExecutor(std::size_t threads)
    : Executor(std::chrono::nanoseconds(0)),
      threads_(threads != 0 ? threads : std::max(2u, std::thread::hardware_concurrency())) {}

void MultiThreadedExecutor::spin() {
  const Spinning spinning(state());
  ExecutorCore& core = *state().core;
  FirstException first;
  const auto work = [&]() noexcept(false) {
    const Leaving leaving(core);
    first.guard([&] {
      while (!core.is_cancelled() && !first) {
        if (!core.run_next()) core.wait(std::nullopt);
      }
    });
  };
  core.share(true);
  SpinningThreads threads(core);
  first.guard([&] {
    for (std::size_t i = 1; i < threads_; ++i) threads.start(work);
  });
  work();
  threads.join();
  core.share(false);
  core.take_cancel();
  first.rethrow();
}

}  // namespace agnocast
