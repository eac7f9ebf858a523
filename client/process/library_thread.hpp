// SPDX-License-Identifier: Apache-2.0
//
// LibraryThread: the threads of the library's own, and the signals that user code sees in them.
//
// Signals are for the user's threads. A library thread blocks nearly all of them (base/signals.hpp)
// while it sleeps or works for itself, so the kernel gives those of the process to the user's threads.
// User code that it runs (callbacks, destructors of messages and of callbacks) sees the mask of the
// thread that made the endpoint, and so does what that code starts: children, threads, raise(). A
// change of the mask is a system call, so a thread that has many callbacks to run changes it once,
// and changes back before it sleeps.
//
// The kernel keeps a process for as long as it has threads. Where `main` has ended by pthread_exit()
// the process is over with its last thread, and the library's do not count: when no other is left and
// no user code runs, they end, and with the last of them the process, as it would without the library.
// Who looks is the control thread, at its tick (look_for_users()).
#pragma once

#include <base/signals.hpp>

#include <pthread.h>
#include <sys/types.h>

#include <csignal>
#include <cstddef>
#include <cstdint>

namespace agnocast {

/// The signals that the thread that makes it has blocked, or those of whom it acts for.
class SignalMask {
 public:
  SignalMask() noexcept;
  const sigset_t& set() const noexcept { return set_; }

 private:
  sigset_t set_{};
};

/// While it lives, what this thread makes has this mask: for a library thread that makes endpoints in the
/// name of the user.
class ActingFor {
 public:
  explicit ActingFor(const SignalMask& mask) noexcept;
  ~ActingFor();
  ActingFor(const ActingFor&) = delete;
  ActingFor& operator=(const ActingFor&) = delete;

 private:
  const SignalMask* before_;
};

/// For the whole function of a library thread. What is left of the thread after it (destructors of
/// thread_local objects, and exit handlers if it is the last one) is user code.
class LibraryThread {
 public:
  /// `end(of)` wakes this one when is_over(): any thread; it must not wait, nor take a lock under which a
  /// LibraryThread is made.
  enum class Sleep : std::uint8_t { as_it_is, can_be_cancelled };
  LibraryThread(void (*end)(void* of) noexcept, void* of,
                Sleep sleep = Sleep::as_it_is) noexcept;
  ~LibraryThread();
  LibraryThread(const LibraryThread&) = delete;
  LibraryThread& operator=(const LibraryThread&) = delete;

  /// Starts a detached thread with all signals blocked; its function makes a LibraryThread first. Its stack is as large
  /// as that of main, or small_stack_bytes where that cannot be had. 0, or why not: errno.
  static int start(const char* name, void* (*body)(void*), void* argument) noexcept;
  static constexpr std::size_t small_stack_bytes = std::size_t{1} << 20;

  /// What is left of library threads has the mask of this thread of the user's. Once, before the first.
  static void be_started_here() noexcept;

  /// The user's last thread has ended: all of the library's shall end. Any thread.
  static bool is_over() noexcept;
  /// Nobody can ring any more: threads whose sleep can be cancelled end. Any thread.
  static void end_sleeps() noexcept;
  /// Control thread: ends them all if the user's last thread has ended. Looks at most once a second;
  /// one system call while `main` lives.
  static void look_for_users() noexcept;

 private:
  void (*const end_)(void*) noexcept;
  void* const of_;
  const pid_t number_;
  const pthread_t thread_;
  const Sleep sleep_;
  LibraryThread *next_ = nullptr, *before_ = nullptr;  // of all

  friend struct LibraryThreads;
};

/// In a library thread: from now on it has this mask. In others nothing happens.
void take_on_signals(const SignalMask& mask) noexcept;
/// In a library thread: signals are blocked again. A system call if they are not.
void shed_signals() noexcept;

/// Around user code that comes seldom.
class UserSignals {
 public:
  explicit UserSignals(const SignalMask& mask) noexcept;
  ~UserSignals();
  UserSignals(const UserSignals&) = delete;
  UserSignals& operator=(const UserSignals&) = delete;

 private:
  const bool had_taken_on_;
  const sigset_t before_;
};

}  // namespace agnocast
