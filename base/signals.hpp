// SPDX-License-Identifier: Apache-2.0
//
// SignalsBlocked: while a thread of ours is started, which inherits the mask.
//
// Signals are the application's, and so are its threads to handle them in. But for what a thread
// brings upon itself: blocked, a fault would end the process past its handlers (a crash reporter, a
// runtime that catches null pointers), and messages' destructors and callbacks are its code.
#pragma once

#include <csignal>
#include <initializer_list>

namespace agnocast {

/// What threads of ours have blocked.
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
