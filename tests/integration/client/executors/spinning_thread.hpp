// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/executor.hpp>

#include <sys/types.h>
#include <unistd.h>

#include <atomic>
#include <thread>

namespace agnocast {

/// Runs an executor's spin() in a thread until the end of the scope.
class SpinningThread {
 public:
  explicit SpinningThread(Executor& executor)
      : executor_(executor), thread_([this] {
          number_ = ::gettid();
          executor_.spin();
        }) {}
  ~SpinningThread() {
    executor_.cancel();
    thread_.join();
  }
  /// The thread's number in the kernel; 0: it has not begun.
  pid_t number() const noexcept { return number_; }

 private:
  Executor& executor_;
  std::atomic<pid_t> number_{0};
  std::thread thread_;
};

}  // namespace agnocast
