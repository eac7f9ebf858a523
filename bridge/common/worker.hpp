// SPDX-License-Identifier: Apache-2.0
//
// Worker: a thread for jobs that may take time, one after the other.
#pragma once

#include <condition_variable>
#include <functional>
#include <list>
#include <mutex>
#include <thread>
#include <utility>

namespace agnocast::bridge {

/// Any thread. Its own thread sleeps while there is no job.
class Worker {
 public:
  Worker() : thread_([this] { work(); }) {}
  /// Waits for the current job; pending jobs are destroyed with what they own.
  ~Worker() {
    {
      const std::lock_guard lock(mutex_);
      stops_ = true;
    }
    changed_.notify_one();
    thread_.join();
  }
  Worker(const Worker&) = delete;
  Worker& operator=(const Worker&) = delete;

  /// A job that returns true runs again after the others, without needing memory. Exceptions are
  /// ignored. add() throws std::bad_alloc.
  using Job = std::function<bool()>;
  void add(Job job) {
    {
      const std::lock_guard lock(mutex_);
      jobs_.push_back(std::move(job));
    }
    changed_.notify_one();
  }

 private:
  void work() noexcept {
    std::unique_lock lock(mutex_);
    for (;;) {
      changed_.wait(lock, [this] { return stops_ || !jobs_.empty(); });
      if (stops_) return;
      std::list<Job> present;
      present.splice(present.begin(), jobs_, jobs_.begin());
      lock.unlock();
      bool again = false;
      try {
        again = present.front()();
      } catch (...) {
      }
      if (!again) present.clear();
      lock.lock();
      jobs_.splice(jobs_.end(), present);
    }
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  std::list<Job> jobs_;
  bool stops_ = false;
  std::thread thread_;
};

}  // namespace agnocast::bridge
