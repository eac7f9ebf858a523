// SPDX-License-Identifier: Apache-2.0
//
// Waiting: how a command that repeats waits for its next round or its end. SIGINT and SIGTERM only
// end the wait, so that the command can print its last lines and exit with status 0.
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <signal.h>
#include <sys/types.h>

namespace agnocast::ctl {

class Waiting {
 public:
  Waiting();
  ~Waiting();
  Waiting(const Waiting&) = delete;
  Waiting& operator=(const Waiting&) = delete;

  /// Returns false when the command is to end.
  bool sleep_ms(int milliseconds) const { return wait(-1, milliseconds) != Event::end; }

  enum class Event : unsigned char { time, input, end };
  /// Waits for a signal, for `fd` (-1: none) to become readable, or until the time is over.
  Event wait(int fd, int milliseconds) const;

 private:
  sigset_t before_{};
  UniqueFd signals_;
};

}  // namespace agnocast::ctl
