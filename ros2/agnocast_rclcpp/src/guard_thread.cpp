// SPDX-License-Identifier: Apache-2.0

#include "guard_thread.hpp"

#include "group_waitable.hpp"

#include <agnocast/callback_group.hpp>
#include <agnocast/executor.hpp>

#include <pthread.h>
#include <signal.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <exception>
#include <optional>
#include <system_error>

namespace agnocast_rclcpp {
namespace {

constexpr std::uint64_t end_number = 0;
constexpr std::uint32_t once = EPOLLIN | EPOLLONESHOT;
// Interval of asking every group when the program has closed a descriptor of ours.
constexpr std::chrono::milliseconds polling_interval{10};

int checked(int result, const char* what) {
  if (result < 0) throw std::system_error(errno, std::generic_category(), what);
  return result;
}

epoll_event event_of(std::uint64_t number, std::uint32_t events) {
  epoll_event event{};
  event.events = events;
  event.data.u64 = number;
  return event;
}

/// While it exists, the daemon knows the thread that made it as one of the group "agnocast-guard",
/// to which thread rules may apply. Without memory or descriptors the thread has no rule.
class ThreadRule {
 public:
  ThreadRule() noexcept {
    try {
      group_ = agnocast::detail::make_callback_group("/agnocast-guard",
                                                     agnocast::CallbackGroupType::MutuallyExclusive,
                                                     false, "agnocast-guard");
      executor_.emplace();
      executor_->add_callback_group(group_);
      executor_->spin_some();
    } catch (const std::exception&) {
    }
  }

 private:
  agnocast::CallbackGroup::SharedPtr group_;
  std::optional<agnocast::SingleThreadedExecutor> executor_;
};

}  // namespace

GuardThread& GuardThread::instance() {
  static GuardThread* const only = [] {
    auto* const made = new GuardThread;
    // Before the statics of rclcpp are destroyed, which were made before.
    std::atexit([] { instance().end(); });
    return made;
  }();
  return *only;
}

GuardThread::GuardThread()
    : epoll_(checked(::epoll_create1(EPOLL_CLOEXEC), "epoll_create1")),
      ended_(checked(::eventfd(1, EFD_CLOEXEC), "eventfd")) {
  epoll_event event = event_of(end_number, 0);
  checked(::epoll_ctl(epoll_, EPOLL_CTL_ADD, ended_, &event), "epoll_ctl");
  // Signals are for the threads of the user.
  sigset_t all, before;
  ::sigfillset(&all);
  ::pthread_sigmask(SIG_SETMASK, &all, &before);
  try {
    thread_ = std::thread([this] { run(); });
  } catch (...) {
    ::pthread_sigmask(SIG_SETMASK, &before, nullptr);
    throw;
  }
  ::pthread_sigmask(SIG_SETMASK, &before, nullptr);
  ::pthread_setname_np(thread_.native_handle(), "agnocast-guard");
}

std::uint64_t GuardThread::next_number() noexcept {
  return last_.fetch_add(1, std::memory_order_relaxed) + 1;
}

void GuardThread::add(std::uint64_t number, const std::shared_ptr<GroupWaitable>& waitable,
                      int fd) {
  const std::lock_guard lock(mutex_);
  waitables_.emplace(number, waitable);
  epoll_event event = event_of(number, 0);
  if (::epoll_ctl(epoll_, EPOLL_CTL_ADD, fd, &event) != 0) {
    const int error = errno;
    waitables_.erase(number);
    throw std::system_error(error, std::generic_category(), "epoll_ctl");
  }
}

void GuardThread::arm(std::uint64_t number, int fd) noexcept {
  if (!is_here()) return;
  epoll_event event = event_of(number, once);
  if (::epoll_ctl(epoll_, EPOLL_CTL_MOD, fd, &event) == 0) return;
  const std::lock_guard lock(mutex_);
  if (waitables_.count(number) != 0)
    has_lost_descriptor_.store(true);  // it was not removed meanwhile
}

void GuardThread::remove(std::uint64_t number, int fd) noexcept {
  if (!is_here()) return;
  {
    const std::lock_guard lock(mutex_);
    waitables_.erase(number);
  }
  epoll_event event{};
  ::epoll_ctl(epoll_, EPOLL_CTL_DEL, fd, &event);
}

void GuardThread::run() noexcept {
  const ThreadRule rule;
  using Clock = std::chrono::steady_clock;
  auto last_look = Clock::now();
  while (!is_over_.load(std::memory_order_acquire)) {
    epoll_event events[16];
    const std::chrono::milliseconds interval = look_interval_;
    const auto pause = has_lost_descriptor_ ? polling_interval : interval;
    const int count = ::epoll_wait(epoll_, events, 16, static_cast<int>(pause.count()));
    if (count < 0 && errno != EINTR) {
      has_lost_descriptor_.store(true);
      std::this_thread::sleep_for(polling_interval);
    }
    for (int i = 0; i < count; ++i) {
      if (events[i].data.u64 == end_number) continue;  // is_over_ is set
      ring_one(events[i].data.u64);
    }
    if (Clock::now() - last_look < interval && !has_lost_descriptor_) continue;
    ring_all();
    last_look = Clock::now();
  }
}

void GuardThread::ring_one(std::uint64_t number) noexcept {
  std::shared_ptr<GroupWaitable> waitable;
  {
    const std::lock_guard lock(mutex_);
    const auto found = waitables_.find(number);
    if (found != waitables_.end()) waitable = found->second.lock();
  }
  if (waitable != nullptr) waitable->ring();
}

void GuardThread::ring_all() noexcept {
  for (std::uint64_t number = 0;; ++number) {
    {
      const std::lock_guard lock(mutex_);
      const auto next = waitables_.lower_bound(number);
      if (next == waitables_.end()) return;
      number = next->first;
    }
    ring_one(number);
  }
}

void GuardThread::end() noexcept {
  if (!is_here()) return;
  is_over_.store(true, std::memory_order_release);
  // The descriptor is readable from the beginning, and nothing is written to it: it may be a file
  // of the program by now. Without this ring, the thread ends within a second.
  epoll_event event = event_of(end_number, EPOLLIN);
  ::epoll_ctl(epoll_, EPOLL_CTL_MOD, ended_, &event);
  if (thread_.get_id() != std::this_thread::get_id()) thread_.join();
}

}  // namespace agnocast_rclcpp
