// SPDX-License-Identifier: Apache-2.0
//
// Parts of executors that spin in several threads of the user.
#pragma once

#include <agnocast/exceptions.hpp>
#include <client/executors/executor_core.hpp>

#include <cxxabi.h>
#include <pthread.h>

#include <atomic>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {

/// The first exception of several threads. Any thread may call any function.
class FirstException {
 public:
  /// Calls `function`; keeps what it throws. The end of a thread (pthread_exit) goes through.
  template <class Function>
  void guard(Function&& function) {
    try {
      function();
    } catch (const ::abi::__forced_unwind&) {
      throw;
    } catch (...) {
      const std::lock_guard lock(mutex_);
      if (exception_ == nullptr) exception_ = std::current_exception();
      has_one_.store(true, std::memory_order_release);
    }
  }
  explicit operator bool() const noexcept { return has_one_.load(std::memory_order_acquire); }
  void rethrow() {
    const std::lock_guard lock(mutex_);
    if (exception_ != nullptr) std::rethrow_exception(std::exchange(exception_, nullptr));
  }

 private:
  std::mutex mutex_;
  std::exception_ptr exception_;
  std::atomic<bool> has_one_{false};
};

/// When it is destroyed, this thread leaves the executor to the others.
class Leaving {
 public:
  explicit Leaving(ExecutorCore& core) noexcept : core_(core) {}
  ~Leaving() { core_.leave(); }
  Leaving(const Leaving&) = delete;
  Leaving& operator=(const Leaving&) = delete;

 private:
  ExecutorCore& core_;
};

class SpinningThreads {
 public:
  explicit SpinningThreads(ExecutorCore& core) noexcept : core_(core) {}
  /// Cancels the executor if threads are left: the spinning thread ends (pthread_exit).
  ~SpinningThreads() {
    if (threads_.empty()) return;
    core_.cancel();
    join();
  }
  SpinningThreads(const SpinningThreads&) = delete;
  SpinningThreads& operator=(const SpinningThreads&) = delete;
  /// Throws Error: os_failure.
  template <class Function>
  void start(Function function) {
    try {
      threads_.emplace_back(std::move(function));
    } catch (const std::system_error& refused) {
      throw Error({Errc::os_failure, refused.code().value(), "starting a thread of an executor"});
    }
    ::pthread_setname_np(threads_.back().native_handle(), "agnocast-exec");
  }
  void join() {
    for (std::thread& thread : threads_) thread.join();
    threads_.clear();
  }

 private:
  ExecutorCore& core_;
  std::vector<std::thread> threads_;
};

}  // namespace agnocast
