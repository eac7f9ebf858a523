// SPDX-License-Identifier: Apache-2.0
//
// User code: callbacks and destructors of messages, run by threads of the library's own.
//
// Static objects are destroyed by exit handlers, while those threads go on. What callbacks and
// destructors use may then be gone, so none begins once a handler of ours has begun, and the handler
// waits for those that run. What the user's own threads do (borrow, publish, executors, release) is theirs
// and goes on working. The handler is registered with the first connection: static objects made
// after that are destroyed before it.
//
// exit() must never hang: the wait is bounded, and a handler that runs inside user code, because
// that has called exit(), does not wait for itself. What a destructor of a static object waits for is
// bounded as well (ExitPatience).
//
// Where `main` has ended by pthread_exit() the process ends with the user's last thread
// (library_thread.hpp). A library thread counts as one while it runs user code. So whether the last
// one has ended is decided while none begins.
#pragma once

#include <agnocast/result.hpp>

#include <chrono>

namespace agnocast {

/// Once, before the first thread of the library's own. Errors: os_failure.
[[nodiscard]] Result<void> end_user_code_at_exit() noexcept;

/// Exit handlers have begun: nothing is created any more. Any thread.
bool exit_has_begun() noexcept;
/// What creation functions begin with.
[[nodiscard]] Result<void> refuse_after_exit() noexcept;

/// None begins while `is_last()` is asked: true if it says so and none runs, and then none will begin
/// any more. For one thread at a time, outside of user code.
bool end_user_code_if(bool (*is_last)() noexcept) noexcept;
/// end_user_code_if() has said so. Any thread.
bool user_threads_have_ended() noexcept;

/// For what destructors wait for, if it is user code and may have no end: exit() must end. How long,
/// for all that wait in one exit() together.
class ExitPatience {
 public:
  /// Between two looks.
  static constexpr std::chrono::milliseconds look{500};
  /// This thread is inside exit(), and has waited there for its time. Any thread; seldom, as it looks at
  /// the stack.
  static bool is_over() noexcept;
};

/// For the library's own threads, around whatever may run user code. May be nested.
class UserCode {
 public:
  UserCode() noexcept;
  ~UserCode();
  UserCode(const UserCode&) = delete;
  UserCode& operator=(const UserCode&) = delete;
  /// False: exit handlers have begun or the user's last thread has ended, and no user code may run.
  bool may_run() const noexcept { return may_run_; }

 private:
  bool may_run_;
};

}  // namespace agnocast
