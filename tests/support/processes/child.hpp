// SPDX-License-Identifier: Apache-2.0
//
// A forked child that runs a function and exits with its value; the destructor kills and reaps it
// at the latest.
#pragma once

#include <signal.h>
#include <sys/types.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <utility>

namespace agnocast::test {

class Child {
 public:
  /// Runs `body()` in the child; its int becomes the exit status.
  template <class Body>
  explicit Child(Body&& body) : pid_(::fork()) {
    if (pid_ < 0) std::abort();
    if (pid_ == 0) ::_exit(std::forward<Body>(body)());
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;
  ~Child() {
    if (pid_ > 0) {
      kill();
      wait();
    }
  }

  pid_t pid() const { return pid_; }
  void kill(int signal = SIGKILL) const { ::kill(pid_, signal); }
  /// Returns the exit status, or minus the signal. Reaps: the pid is free afterwards.
  int wait() {
    int status = 0;
    while (::waitpid(pid_, &status, 0) < 0 && errno == EINTR) {
    }
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }
  /// Blocks until the child is dead, without reaping it: a zombie keeps its pid.
  void wait_until_zombie() const {
    siginfo_t info{};
    while (::waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOWAIT) < 0 &&
           errno == EINTR) {
    }
  }

 private:
  pid_t pid_;
};

/// The body of a child that does nothing until it is killed.
inline int sleep_for_ever() {
  for (;;) ::pause();
}

}  // namespace agnocast::test
