// SPDX-License-Identifier: Apache-2.0

#include <client/executors/executor_state.hpp>
#include <client/executors/spinning_threads.hpp>

#include <algorithm>
#include <thread>

namespace agnocast {

MultiThreadedExecutor::MultiThreadedExecutor(std::size_t threads)
    : Executor(std::chrono::nanoseconds(0)),
      threads_(threads != 0 ? threads : std::max(2u, std::thread::hardware_concurrency())) {}

void MultiThreadedExecutor::spin() {
  const Spinning spinning(state());
  FirstException first;
  first.guard([&] { SpinningThreads(*state().core).run(threads_ - 1, first); });
  if (!first) state().core->take_cancel();
  first.rethrow();
}

}  // namespace agnocast
