// SPDX-License-Identifier: Apache-2.0
//
// BackgroundThread: a thread of the library that spins an executor.
//
// A callback may end its thread (pthread_exit). That is a library thread, so the executor gets a
// new one, which begins when the first has ended, and the message counts as delivered.
#pragma once

#include <agnocast/result.hpp>
#include <client/executors/executor_core.hpp>

#include <condition_variable>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>

namespace agnocast {

class BackgroundThread {
 public:
  /// Starts a thread that spins `core` until its cancel. Errors: os_failure.
  [[nodiscard]] static Result<std::shared_ptr<BackgroundThread>> start(
      std::shared_ptr<ExecutorCore> core);

  explicit BackgroundThread(std::shared_ptr<ExecutorCore> core) noexcept : core_(std::move(core)) {}
  BackgroundThread(const BackgroundThread&) = delete;
  BackgroundThread& operator=(const BackgroundThread&) = delete;

  /// Cancels the executor and waits until the thread has ended, unless it is this thread, or waits
  /// for this one, or this one is inside exit() and has waited long enough.
  void join() noexcept;
  bool has_ended() const noexcept {
    const std::lock_guard lock(mutex_);
    return has_ended_;
  }

 private:
  struct Life;
  static Result<void> start_next(const std::shared_ptr<BackgroundThread>& self);
  void run(const std::shared_ptr<BackgroundThread>& self);
  void serve();
  bool run_next();

  const std::shared_ptr<ExecutorCore> core_;  // the thread may outlive the executor: join()
  mutable std::mutex mutex_;
  std::condition_variable ended_;
  bool has_ended_ = false;
  std::thread thread_, before_;  // thread_ waits for before_
  bool is_joined_ = false;       // start no further thread
};

}  // namespace agnocast
