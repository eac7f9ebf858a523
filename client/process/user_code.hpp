// SPDX-License-Identifier: Apache-2.0
//
// User code: callbacks and destructors of messages that library threads run.
//
// Exit handlers destroy static objects while those threads go on. Objects that callbacks and
// destructors use may then be gone, so no user code begins in library threads once our exit
// handler has begun, and the handler waits for running user code. Calls by the user's own threads
// (borrow, publish, executors, release) keep working. The handler is registered with the first
// connection: static objects made after that are destroyed before it.
//
// exit() must never hang: the wait is bounded, and a handler that runs inside user code, because
// that has called exit(), does not wait for itself. Waits in destructors of static objects are
// bounded as well (ExitPatience).
//
// If `main` has ended by pthread_exit(), the process ends with the user's last thread
// (library_thread.hpp). A library thread counts as one while it runs user code. So the check for
// the last thread runs while no user code can begin.
#pragma once

#include <agnocast/result.hpp>

#include <chrono>

namespace agnocast {

/// Registers the exit handler. Call it once, before the first library thread. Errors: os_failure.
[[nodiscard]] Result<void> end_user_code_at_exit() noexcept;

/// Returns whether exit handlers have begun: nothing may be created any more. Any thread.
bool exit_has_begun() noexcept;
/// Creation functions begin with this.
[[nodiscard]] Result<void> refuse_after_exit() noexcept;

/// Calls `is_last()` while no user code can begin. Returns true, and forbids user code for good,
/// if it returns true and no user code runs. One thread at a time, outside of user code.
bool end_user_code_if(bool (*is_last)() noexcept) noexcept;
/// Returns whether end_user_code_if() has returned true. Any thread.
bool user_threads_have_ended() noexcept;

/// Bounds the waits of destructors for user code that may never end, because exit() must end. All
/// waits in one exit() share one time.
class ExitPatience {
 public:
  /// Interval between two checks.
  static constexpr std::chrono::milliseconds look{500};
  /// Returns whether this thread is inside exit() and has used up that time. Any thread;
  /// expensive, because it searches the stack.
  static bool is_over() noexcept;
};

/// For library threads, around code that may run user code. Nests.
class UserCode {
 public:
  UserCode() noexcept;
  ~UserCode();
  UserCode(const UserCode&) = delete;
  UserCode& operator=(const UserCode&) = delete;
  /// Returns false if no user code may run: exit handlers have begun or the user's last thread
  /// has ended.
  bool may_run() const noexcept { return may_run_; }

 private:
  bool may_run_;
};

}  // namespace agnocast
