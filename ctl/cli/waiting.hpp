// SPDX-License-Identifier: Apache-2.0
//
// Waiting: how a command that goes on waits: until it is time, or somebody ends it. SIGINT and SIGTERM
// then only end the waiting, so that the command says its last words and ends well.
#pragma once

#include <base/unique_fd.hpp>

#include <signal.h>
#include <sys/types.h>

namespace agnocast::ctl {

class Waiting {
 public:
  Waiting();
  ~Waiting();
  Waiting(const Waiting&) = delete;
  Waiting& operator=(const Waiting&) = delete;

  /// False when it is to end.
  bool sleep_ms(int milliseconds) const { return wait(-1, milliseconds) != Event::end; }

  enum class Event : unsigned char { time, input, end };
  /// Until then, or until `fd` (-1: none) can be read.
  Event wait(int fd, int milliseconds) const;

 private:
  sigset_t before_{};
  UniqueFd signals_;
};

}  // namespace agnocast::ctl
