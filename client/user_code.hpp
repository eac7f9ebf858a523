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
// that has called exit(), does not wait for itself.
#pragma once

#include <agnocast/result.hpp>

namespace agnocast {

/// Once, before the first thread of the library's own. Errors: os_failure.
[[nodiscard]] Result<void> end_user_code_at_exit() noexcept;

/// Exit handlers have begun: nothing is created any more. Any thread.
bool exit_has_begun() noexcept;
/// What creation functions begin with.
[[nodiscard]] Result<void> refuse_after_exit() noexcept;

/// For the library's own threads, around whatever may run user code. May be nested.
class UserCode {
 public:
  UserCode() noexcept;
  ~UserCode();
  UserCode(const UserCode&) = delete;
  UserCode& operator=(const UserCode&) = delete;
  /// False: exit handlers have begun, and no user code may run.
  bool may_run() const noexcept { return may_run_; }

 private:
  bool may_run_;
};

}  // namespace agnocast
