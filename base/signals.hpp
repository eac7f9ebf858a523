// SPDX-License-Identifier: Apache-2.0
//
// SignalsBlocked: blocks signals while one of our threads is started, which inherits the mask.
//
// The application handles signals in its own threads. Exceptions are those that a thread causes
// itself: if they were blocked, a fault would end the process past its handlers (a crash
// reporter, a runtime that catches null pointers), and messages' destructors and callbacks are
// the application's code.
#pragma once

#include <csignal>
#include <initializer_list>

namespace agnocast {

/// Returns the signals that our threads block.
inline sigset_t blocked_signals() noexcept {
  sigset_t blocked;
  ::sigfillset(&blocked);
  for (const int own : {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGTRAP, SIGSYS, SIGABRT})
    ::sigdelset(&blocked, own);
  return blocked;
}

class SignalsBlocked {
 public:
  SignalsBlocked() noexcept {
    const sigset_t wanted = blocked_signals();
    ::pthread_sigmask(SIG_SETMASK, &wanted, &before_);
  }
  ~SignalsBlocked() { ::pthread_sigmask(SIG_SETMASK, &before_, nullptr); }
  SignalsBlocked(const SignalsBlocked&) = delete;
  SignalsBlocked& operator=(const SignalsBlocked&) = delete;

 private:
  sigset_t before_{};
};

}  // namespace agnocast
