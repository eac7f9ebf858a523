// SPDX-License-Identifier: Apache-2.0

#include <base/descriptors/kept_fd.hpp>

#include <fcntl.h>
#include <pthread.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>

// close(3), under the linker's name where close() is wrapped. Elsewhere nothing is kept, and
// nothing closed here.
extern "C" [[gnu::weak]] int __real_close(int fd);

namespace agnocast {
namespace {

// 64 KiB; only the used part has memory. Numbers beyond are not tracked.
constexpr int number_end = 8192;
// Above the numbers that programs usually have open. Half of a smaller limit.
constexpr int high_number = 512;

// Identity of the file behind each kept number; 0: not kept. All eventfds, timers and epoll sets
// share one inode: among them only the number identifies.
constinit std::atomic<std::uint64_t> identities[number_end] = {};
constinit std::atomic<int> highest{-1};  // number ever kept

std::uint64_t identity_of(int fd) noexcept {
  struct stat status {};
  // What fstat() does. lost_kept() looks at numbers that their owners may be closing, on purpose;
  // ThreadSanitizer knows fstat(), and would report that as a race.
  if (::fstatat(fd, "", &status, AT_EMPTY_PATH) != 0) return 0;
  const std::uint64_t sum =
      (status.st_dev * 0x9e3779b97f4a7c15 ^ status.st_ino) * 0x9e3779b97f4a7c15 ^ status.st_mode;
  return sum != 0 ? sum : 1;
}

int lowest_wanted() noexcept {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return high_number;
  return static_cast<int>(std::min<rlim_t>(limit.rlim_cur / 2, high_number));
}

// close() of this number only reports that close() is wrapped.
constexpr int no_number = -4242;
constinit std::atomic<bool> close_is_ours{false};

bool is_guarded() noexcept {
  static const bool guarded = [] {
    const int before = errno;
    ::close(no_number);
    errno = before;
    return close_is_ours.load(std::memory_order_relaxed);
  }();
  return guarded;
}

int close_if_intact(int fd) noexcept {
  if (fd == no_number) {
    close_is_ours.store(true, std::memory_order_relaxed);
    return 0;
  }
  if (fd >= 0 && fd < number_end) {
    const std::uint64_t kept = identities[fd].load(std::memory_order_relaxed);
    if (kept != 0 && kept != identity_of(fd)) return 0;  // another file; stays marked as lost
    identities[fd].store(0, std::memory_order_relaxed);
  }
  // Cancellation in close(3) would end a destructor half way. Not by the bare system call, which
  // sanitizers do not see: they would report the next descriptor of this number as a race with
  // the last.
  int before = PTHREAD_CANCEL_ENABLE;
  ::pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, &before);
  const int status = __real_close(fd);
  ::pthread_setcancelstate(before, nullptr);
  return status;
}

}  // namespace

// The linker redirects close() of everything linked with this file here.
extern "C" int __wrap_close(int fd);
extern "C" int __wrap_close(int fd) { return close_if_intact(fd); }

UniqueFd keep(UniqueFd fd) noexcept {
  if (!fd || !is_guarded()) return fd;
  const int before = errno;
  if (const int high = ::fcntl(fd.get(), F_DUPFD_CLOEXEC, lowest_wanted()); high >= 0)
    fd.reset(high);
  if (fd.get() < number_end) {
    identities[fd.get()].store(identity_of(fd.get()), std::memory_order_relaxed);
    int most = highest.load(std::memory_order_relaxed);
    while (most < fd.get() && !highest.compare_exchange_weak(most, fd.get())) {
    }
  }
  errno = before;
  return fd;
}

bool is_intact(int fd) noexcept {
  if (fd < 0) return false;
  if (fd >= number_end) return true;
  const std::uint64_t kept = identities[fd].load(std::memory_order_relaxed);
  if (kept == 0) return true;
  const int before = errno;
  const bool intact = kept == identity_of(fd);
  errno = before;
  return intact;
}

bool lost_kept() noexcept {
  if (has_lost_kept()) return true;
  for (int fd = 0; fd <= highest.load(std::memory_order_relaxed); ++fd) {
    // Its owner may close it, and keep another one there, between two checks.
    const auto is_lost = [&] {
      return identities[fd].load(std::memory_order_relaxed) != 0 && !is_intact(fd);
    };
    if (!is_lost() || (::sched_yield(), !is_lost()) || (::sched_yield(), !is_lost())) continue;
    detail::has_lost_kept.store(true, std::memory_order_relaxed);
    return true;
  }
  return false;
}

}  // namespace agnocast
