// SPDX-License-Identifier: Apache-2.0
//
// Parts of executors that spin in several threads of the user.
#pragma once

#include <agnocast/exceptions.hpp>
#include <client/executors/executor_core.hpp>
#include <client/process/forked_child.hpp>

#include <cxxabi.h>
#include <pthread.h>

#include <atomic>
#include <cerrno>
#include <exception>
#include <memory>
#include <mutex>
#include <new>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {

/// The first exception of several threads. Any thread may call any function.
class FirstException {
 public:
  /// Calls `function`; keeps what it throws. The end of a thread (pthread_exit) goes through. In a
  /// forked child it keeps nothing: the spin functions throw shut_down there.
  template <class Function>
  void guard(Function&& function) {
    try {
      function();
    } catch (const ::abi::__forced_unwind&) {
      throw;
    } catch (...) {
      if (is_forked_child()) return;  // the lock may belong to the parent
      const std::lock_guard lock(mutex_);
      if (exception_ == nullptr) exception_ = std::current_exception();
      has_one_.store(true, std::memory_order_release);
    }
  }
  explicit operator bool() const noexcept { return has_one_.load(std::memory_order_acquire); }
  /// Call it when no other thread is left, or in a forked child.
  void rethrow() {
    if (Result<void> refused = refuse_forked_child(); !refused) throw Error(refused.error());
    if (exception_ != nullptr) std::rethrow_exception(std::exchange(exception_, nullptr));
  }

 private:
  std::mutex mutex_;
  std::exception_ptr exception_;
  std::atomic<bool> has_one_{false};
};

/// Starts a thread that calls `function`. Errors: os_failure.
template <class Function>
[[nodiscard]] Result<std::thread> start_spinning_thread(Function&& function) noexcept {
  int error = ENOMEM;
  try {
    std::thread thread(std::forward<Function>(function));
    ::pthread_setname_np(thread.native_handle(), "agnocast-exec");
    return thread;
  } catch (const std::system_error& refused) {
    error = refused.code().value();
  } catch (const std::bad_alloc&) {
  }
  return fail(Errc::os_failure, "starting a thread of an executor", error);
}

/// The threads of one spin(): the calling one and further ones, which share a core.
class SpinningThreads {
 public:
  explicit SpinningThreads(ExecutorCore& core)
      : core_(core), threads_(std::make_unique<std::vector<std::thread>>()) {
    core_.share(true);
  }
  /// Ends and joins all, also if the spinning thread itself is ended (pthread_exit).
  ~SpinningThreads() {
    if (is_forked_child()) {
      (void)threads_.release();  // they are the parent's
      return;
    }
    stop();
    for (std::thread& thread : *threads_) thread.join();
    core_.share(false);
  }
  SpinningThreads(const SpinningThreads&) = delete;
  SpinningThreads& operator=(const SpinningThreads&) = delete;

  /// Runs callbacks in `count` further threads and in this one, until a cancel or stop(). Throws
  /// what the callbacks of this thread throw; exceptions of the others go to `first`.
  void run(std::size_t count, FirstException& first) {
    threads_->reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
      auto started = start_spinning_thread([this, &first] {
        const Leaving leaving{core_};
        first.guard([this] { run_callbacks(); });
        if (first) stop();
      });
      if (!started) throw Error(started.error());
      threads_->push_back(std::move(*started));
    }
    const Leaving leaving{core_};
    run_callbacks();
  }

 private:
  /// This thread leaves the executor to the others.
  struct Leaving {
    ExecutorCore& core;
    ~Leaving() { core.leave(); }
  };

  void run_callbacks() {
    while (!core_.is_cancelled() && !is_over_.load(std::memory_order_acquire)) {
      if (!core_.run_next()) core_.wait(std::nullopt);
    }
  }
  void stop() noexcept {
    is_over_.store(true, std::memory_order_release);
    core_.leave();  // and each thread that ends wakes the next
  }

  ExecutorCore& core_;
  std::atomic<bool> is_over_{false};
  std::unique_ptr<std::vector<std::thread>> threads_;
};

}  // namespace agnocast
