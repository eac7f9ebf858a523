// SPDX-License-Identifier: Apache-2.0

#include "guard_thread.hpp"

#include "group_waitable.hpp"

#include <pthread.h>
#include <signal.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>

#include <cerrno>
#include <cstdlib>
#include <system_error>

namespace agnocast_rclcpp {
namespace {

constexpr std::uint64_t end_number = 0;
constexpr std::uint32_t once = EPOLLIN | EPOLLONESHOT;

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
      ended_(checked(::eventfd(0, EFD_CLOEXEC), "eventfd")) {
  epoll_event event = event_of(end_number, EPOLLIN);
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

std::uint64_t GuardThread::add(const std::shared_ptr<GroupWaitable>& waitable, int fd) {
  const std::lock_guard lock(mutex_);
  const std::uint64_t number = ++last_;
  waitables_.emplace(number, waitable);
  epoll_event event = event_of(number, 0);
  if (::epoll_ctl(epoll_, EPOLL_CTL_ADD, fd, &event) != 0) {
    const int error = errno;
    waitables_.erase(number);
    throw std::system_error(error, std::generic_category(), "epoll_ctl");
  }
  return number;
}

void GuardThread::arm(std::uint64_t number, int fd) noexcept {
  if (!is_here()) return;
  epoll_event event = event_of(number, once);
  ::epoll_ctl(epoll_, EPOLL_CTL_MOD, fd, &event);
}

void GuardThread::remove(std::uint64_t number, int fd) noexcept {
  if (!is_here()) return;
  epoll_event event{};
  ::epoll_ctl(epoll_, EPOLL_CTL_DEL, fd, &event);
  const std::lock_guard lock(mutex_);
  waitables_.erase(number);
}

void GuardThread::run() noexcept {
  while (!is_over_.load(std::memory_order_acquire)) {
    epoll_event events[16];
    const int count = ::epoll_wait(epoll_, events, 16, -1);
    // The program has closed descriptors that are not its own: nothing can ring any more.
    if (count < 0 && errno != EINTR) ::usleep(10'000);
    for (int i = 0; i < count; ++i) {
      if (events[i].data.u64 == end_number) return;
      std::shared_ptr<GroupWaitable> waitable;
      {
        const std::lock_guard lock(mutex_);
        const auto found = waitables_.find(events[i].data.u64);
        if (found != waitables_.end()) waitable = found->second.lock();
      }
      if (waitable != nullptr) waitable->ring();
    }
  }
}

void GuardThread::end() noexcept {
  if (!is_here()) return;
  is_over_.store(true, std::memory_order_release);
  ::eventfd_write(ended_, 1);
  if (thread_.get_id() != std::this_thread::get_id()) thread_.join();
}

}  // namespace agnocast_rclcpp
