// SPDX-License-Identifier: Apache-2.0

#include <client/process/library_thread.hpp>

#include <base/descriptors/unique_fd.hpp>
#include <base/immortal.hpp>
#include <base/memory/mapping.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/user_code.hpp>

#include <dirent.h>
#include <fcntl.h>
#include <pthread.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <optional>
#include <string_view>

namespace agnocast {

struct LibraryThreads {
  std::mutex mutex;
  LibraryThread* first = nullptr;
  std::optional<SignalMask> starter;  // constant while there are threads

  bool has(pid_t number) noexcept {
    const std::lock_guard lock(mutex);
    for (const LibraryThread* thread = first; thread != nullptr; thread = thread->next_) {
      if (thread->number_ == number) return true;
    }
    return false;
  }
  void end_all() noexcept {
    const std::lock_guard lock(mutex);
    for (const LibraryThread* thread = first; thread != nullptr; thread = thread->next_)
      thread->end_(thread->of_);
  }
  void end_sleeps() noexcept {
    const std::lock_guard lock(mutex);
    for (const LibraryThread* thread = first; thread != nullptr; thread = thread->next_) {
      if (thread->sleep_ == LibraryThread::Sleep::can_be_cancelled)
        ::pthread_cancel(thread->thread_);
    }
  }
  void add(LibraryThread& thread) noexcept {
    const std::lock_guard lock(mutex);
    thread.next_ = first;
    if (first != nullptr) first->before_ = &thread;
    first = &thread;
  }
  void remove(LibraryThread& thread) noexcept {
    const std::lock_guard lock(mutex);
    if (thread.next_ != nullptr) thread.next_->before_ = thread.before_;
    (thread.before_ != nullptr ? thread.before_->next_ : first) = thread.next_;
  }
};

namespace {

using Clock = std::chrono::steady_clock;

LibraryThreads& threads() noexcept { return immortal<LibraryThreads>(); }

/// State of this thread. Constant initialisation: user code may run in a thread that is about to
/// end.
struct Here {
  bool is_library = false;
  bool has_taken_on = false;  // `now` is a user's mask
  sigset_t now{};
};
thread_local constinit Here here;
thread_local constinit const SignalMask* acting_for = nullptr;

bool is_same(const sigset_t& one, const sigset_t& other) noexcept {
  return std::memcmp(&one, &other, sizeof one) == 0;
}

void take_on(const sigset_t& mask) noexcept {
  if (!here.is_library || (here.has_taken_on && is_same(here.now, mask))) return;
  ::pthread_sigmask(SIG_SETMASK, &mask, nullptr);
  here.now = mask;
  here.has_taken_on = true;
}

// --- remaining threads

// Flags in /proc/PID/task/TID/stat of threads that the kernel has made for the process (io_uring,
// vhost).
constexpr unsigned long works_for_kernel = 0x10 | 0x4000;  // PF_IO_WORKER, PF_USER_WORKER

/// Every thread has a robust list from its start, because glibc registers one; the kernel drops
/// it when the thread ends. So without a list `main` has ended, or its state is unknown.
bool main_may_have_ended() noexcept {
  void* list = nullptr;
  std::size_t bytes = 0;
  return ::syscall(SYS_get_robust_list, ::getpid(), &list, &bytes) != 0 || list == nullptr;
}

/// Returns whether a thread belongs to the user, by its stat file ("pid (name) state ppid pgrp
/// session tty tpgid flags …"). True if the file has no answer.
bool is_users(int directory, const char* number) noexcept {
  char path[32];
  std::snprintf(path, sizeof path, "%.10s/stat", number);
  const UniqueFd file(::openat(directory, path, O_RDONLY | O_CLOEXEC));
  if (!file) return errno != ENOENT && errno != ESRCH;
  char text[512];
  const ssize_t bytes = ::read(file.get(), text, sizeof text - 1);
  if (bytes <= 0) return bytes == 0 || errno != ESRCH;
  text[bytes] = '\0';
  const char* const behind_name = std::strrchr(text, ')');
  char state = '?';
  unsigned long flags = 0;
  if (behind_name == nullptr ||
      std::sscanf(behind_name, ") %c %*d %*d %*d %*d %*d %lu", &state, &flags) != 2)
    return true;
  return state != 'Z' && state != 'X' && (flags & works_for_kernel) == 0;
}

/// Returns whether a thread is left that is not the library's and has not ended.
bool has_users_threads() noexcept {
  struct Close {
    DIR* directory;
    ~Close() {
      if (directory != nullptr) ::closedir(directory);
    }
  };
  const Close task{::opendir("/proc/self/task")};
  if (task.directory == nullptr) return true;
  errno = 0;
  while (const dirent* const entry = ::readdir(task.directory)) {
    const std::string_view name = entry->d_name;
    pid_t number = 0;
    const auto [end, problem] = std::from_chars(name.begin(), name.end(), number);
    if (problem != std::errc() || end != name.end()) continue;  // . and ..
    if (!threads().has(number) && is_users(::dirfd(task.directory), entry->d_name)) return true;
    errno = 0;
  }
  return errno != 0;
}

}  // namespace

SignalMask::SignalMask() noexcept {
  if (acting_for != nullptr) {
    set_ = acting_for->set_;
  } else {
    ::pthread_sigmask(SIG_SETMASK, nullptr, &set_);
  }
}

ActingFor::ActingFor(const SignalMask& mask) noexcept : before_(acting_for) { acting_for = &mask; }
ActingFor::~ActingFor() { acting_for = before_; }

void LibraryThread::be_started_here() noexcept { threads().starter.emplace(); }

LibraryThread::LibraryThread(void (*end)(void*) noexcept, void* of, Sleep sleep) noexcept
    : end_(end),
      of_(of),
      number_(static_cast<pid_t>(::syscall(SYS_gettid))),
      thread_(::pthread_self()),
      sleep_(sleep) {
  here.is_library = true;
  threads().add(*this);
}

LibraryThread::~LibraryThread() {
  if (threads().starter) take_on_signals(*threads().starter);
  here.is_library = false;
  if (!is_forked_child()) threads().remove(*this);  // else the lock may be the parent's
}

bool LibraryThread::is_over() noexcept { return user_threads_have_ended(); }

void LibraryThread::end_sleeps() noexcept { threads().end_sleeps(); }

void LibraryThread::look_for_users() noexcept {
  static std::mutex looking;  // there may be several control threads
  static Clock::time_point next_look;
  {
    const std::unique_lock lock(looking, std::try_to_lock);
    if (!lock || user_threads_have_ended()) return;
    const Clock::time_point now = Clock::now();
    if (now < next_look) return;
    next_look = now + std::chrono::milliseconds{900};  // the control thread ticks once a second
    if (!main_may_have_ended() || has_users_threads()) return;
    if (!end_user_code_if([]() noexcept { return !has_users_threads(); })) return;
  }
  threads().end_all();
}

void take_on_signals(const SignalMask& mask) noexcept { take_on(mask.set()); }

void shed_signals() noexcept {
  if (!here.has_taken_on) return;
  here.has_taken_on = false;
  const sigset_t blocked = blocked_signals();
  ::pthread_sigmask(SIG_SETMASK, &blocked, nullptr);
}

UserSignals::UserSignals(const SignalMask& mask) noexcept
    : had_taken_on_(here.has_taken_on), before_(here.now) {
  take_on_signals(mask);
}
UserSignals::~UserSignals() {
  if (had_taken_on_) {
    take_on(before_);
  } else {
    shed_signals();
  }
}

namespace {

// Message destructors run on it, which may need as much stack as in main; if that has no limit,
// Linux's default. If memory is locked as it is mapped (mlockall), all of the stack would be
// allocated.
constexpr rlim_t default_stack_bytes = rlim_t{8} << 20;

std::size_t stack_bytes() noexcept {
  rlimit main_stack{};
  if (locks_new_mappings() || ::getrlimit(RLIMIT_STACK, &main_stack) != 0)
    return LibraryThread::small_stack_bytes;
  const rlim_t bytes =
      main_stack.rlim_cur == RLIM_INFINITY ? default_stack_bytes : main_stack.rlim_cur;
  return std::max<std::size_t>(bytes, LibraryThread::small_stack_bytes);
}

}  // namespace

int LibraryThread::start(const char* name, void* (*body)(void*), void* argument) noexcept {
  pthread_t thread{};
  const auto start_with = [&](std::size_t bytes) {
    pthread_attr_t attributes;
    ::pthread_attr_init(&attributes);
    ::pthread_attr_setstacksize(&attributes, bytes);
    const SignalsBlocked blocked;
    const int refused = ::pthread_create(&thread, &attributes, body, argument);
    ::pthread_attr_destroy(&attributes);
    return refused;
  };
  int refused = start_with(stack_bytes());
  if (refused != 0) refused = start_with(small_stack_bytes);
  if (refused != 0) return refused;
  ::pthread_setname_np(thread, name);
  ::pthread_detach(thread);
  return 0;
}

}  // namespace agnocast
