// SPDX-License-Identifier: Apache-2.0
//
// LibraryThread: threads of the library, and the signals that user code sees in them.
//
// Signals are for the user's threads. A library thread blocks nearly all of them
// (base/signals.hpp) while it sleeps or works for itself, so the kernel delivers those of the
// process to the user's threads. User code that it runs (callbacks, destructors of messages and
// of callbacks) sees the mask of the thread that made the endpoint; so do children, threads and
// raise() of that code. A change of the mask is a system call, so a thread with many callbacks to
// run changes it once, and changes it back before it sleeps.
//
// The kernel keeps a process as long as it has threads. If `main` has ended by pthread_exit(),
// the process must end with the user's last thread: when none is left and no user code runs, the
// library threads end, and with the last of them the process, as it would without the library.
// The control thread and background executors check that when they wake (look_for_users()).
#pragma once

#include <base/signals.hpp>

#include <pthread.h>
#include <sys/types.h>

#include <csignal>
#include <cstddef>
#include <cstdint>

namespace agnocast {

/// The signals blocked in the thread that makes this object, or in the thread that it acts for.
class SignalMask {
 public:
  SignalMask() noexcept;
  const sigset_t& set() const noexcept { return set_; }

 private:
  sigset_t set_{};
};

/// While it lives, objects made by this thread get this mask: for a library thread that makes
/// endpoints on behalf of the user.
class ActingFor {
 public:
  explicit ActingFor(const SignalMask& mask) noexcept;
  ~ActingFor();
  ActingFor(const ActingFor&) = delete;
  ActingFor& operator=(const ActingFor&) = delete;

 private:
  const SignalMask* before_;
};

/// For the whole function of a library thread. Code that runs in the thread after it (destructors
/// of thread_local objects, and exit handlers if it is the last thread) is user code.
class LibraryThread {
 public:
  /// `end(of)` wakes this thread when is_over(). It is called from any thread; it must not wait,
  /// nor take a lock under which a LibraryThread is made.
  enum class Sleep : std::uint8_t { as_it_is, can_be_cancelled };
  LibraryThread(void (*end)(void* of) noexcept, void* of, Sleep sleep = Sleep::as_it_is) noexcept;
  ~LibraryThread();
  LibraryThread(const LibraryThread&) = delete;
  LibraryThread& operator=(const LibraryThread&) = delete;

  /// Starts a detached thread with all signals blocked; its function makes a LibraryThread first.
  /// Its stack is as large as that of main, or small_stack_bytes if that fails. Returns 0, or
  /// errno.
  static int start(const char* name, void* (*body)(void*), void* argument) noexcept;
  static constexpr std::size_t small_stack_bytes = std::size_t{1} << 20;

  /// Gives the mask of this user thread to code that runs after library threads. Once, before the
  /// first.
  static void be_started_here() noexcept;

  /// Returns whether the user's last thread has ended, so that all library threads must end. Any
  /// thread.
  static bool is_over() noexcept;
  /// Ends the threads whose sleep can be cancelled, because their doorbells are lost. Any thread.
  static void end_sleeps() noexcept;
  /// For library threads that wake once a second: ends all library threads if the user's last
  /// thread has ended. Checks at most once a second; one system call while `main` lives.
  static void look_for_users() noexcept;

 private:
  void (*const end_)(void*) noexcept;
  void* const of_;
  const pid_t number_;
  const pthread_t thread_;
  const Sleep sleep_;
  LibraryThread *next_ = nullptr, *before_ = nullptr;  // list of all

  friend struct LibraryThreads;
};

/// In a library thread, sets this mask from now on. Does nothing in other threads.
void take_on_signals(const SignalMask& mask) noexcept;
/// In a library thread, blocks signals again. A system call if they are not blocked.
void shed_signals() noexcept;

/// Sets the mask around rare user code.
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
