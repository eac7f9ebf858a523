// SPDX-License-Identifier: Apache-2.0
//
// Worker: a thread for what may take its time, one job after the other.
#pragma once

#include <condition_variable>
#include <functional>
#include <list>
#include <mutex>
#include <thread>
#include <utility>

namespace agnocast::bridge {

/// Any thread. Its thread sleeps while there is nothing to do.
class Worker {
 public:
  Worker() : thread_([this] { work(); }) {}
  /// After the present job; jobs that have not begun end with what they hold.
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

  /// True: the job is to be done again, behind the others, which needs no memory. What it throws is lost. Throws
  /// std::bad_alloc.
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
