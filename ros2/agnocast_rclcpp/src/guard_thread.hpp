// SPDX-License-Identifier: Apache-2.0
//
// GuardThread: the one thread of the process that wakes rclcpp's executors. It sleeps on the
// descriptors of all adapted groups, and triggers a guard condition when a group has something to
// do. It runs no callback.
//
// If the program has closed a descriptor that it did not open, a group may never ring again. So the
// thread asks every group once a second, and every 10 ms when it has noticed that.
#pragma once

#include <sys/types.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <thread>

namespace agnocast_rclcpp {

class GroupWaitable;

class GuardThread {
 public:
  /// The only one. It is never destroyed; its thread ends with exit(). In a forked child, whose
  /// descriptors are the parent's, the functions below do nothing.
  static GuardThread& instance();
  /// Returns whether this process made it; otherwise it is a forked child.
  bool is_here() const noexcept { return ::getpid() == owner_; }

  /// Returns a number for the other functions.
  std::uint64_t next_number() noexcept;
  /// From the next arm() on, calls ring() of the waitable once when `fd` is readable, and at times
  /// by itself. Throws std::system_error.
  void add(std::uint64_t number, const std::shared_ptr<GroupWaitable>& waitable, int fd);
  void arm(std::uint64_t number, int fd) noexcept;
  void remove(std::uint64_t number, int fd) noexcept;
  /// How often it asks every group, from its next look on: for tests, whose lost wake-ups must not
  /// be repaired by that.
  void look_each(std::chrono::milliseconds interval) noexcept { look_interval_ = interval; }

 private:
  /// Closes what it has, which happens only where the constructor of GuardThread fails.
  class Descriptor {
   public:
    explicit Descriptor(int fd) noexcept : fd_(fd) {}
    Descriptor(const Descriptor&) = delete;
    ~Descriptor() { ::close(fd_); }
    operator int() const noexcept { return fd_; }

   private:
    const int fd_;
  };

  GuardThread();
  void run() noexcept;
  void ring_one(std::uint64_t number) noexcept;
  void ring_all() noexcept;
  void end() noexcept;

  const pid_t owner_ = ::getpid();
  const Descriptor epoll_, ended_;
  std::atomic<std::chrono::milliseconds> look_interval_{std::chrono::seconds(1)};
  std::atomic<bool> is_over_{false};
  std::atomic<bool> has_lost_descriptor_{false};  // the program has closed one
  std::mutex mutex_;
  std::map<std::uint64_t, std::weak_ptr<GroupWaitable>> waitables_;
  std::atomic<std::uint64_t> last_{0};
  std::thread thread_;
};

}  // namespace agnocast_rclcpp
