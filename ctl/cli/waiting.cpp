// SPDX-License-Identifier: Apache-2.0

#include <ctl/cli/waiting.hpp>

#include <base/clock.hpp>

#include <poll.h>
#include <sys/signalfd.h>

#include <algorithm>
#include <cerrno>

namespace agnocast::ctl {

Waiting::Waiting() {
  sigset_t wanted;
  ::sigemptyset(&wanted);
  ::sigaddset(&wanted, SIGINT);
  ::sigaddset(&wanted, SIGTERM);
  ::pthread_sigmask(SIG_BLOCK, &wanted, &before_);
  signals_ = UniqueFd(::signalfd(-1, &wanted, SFD_CLOEXEC | SFD_NONBLOCK));
}

// Reads pending signals, which would otherwise end the process as soon as they are unblocked.
Waiting::~Waiting() {
  signalfd_siginfo info;
  while (::read(signals_.get(), &info, sizeof info) > 0) {
  }
  ::pthread_sigmask(SIG_SETMASK, &before_, nullptr);
}

Waiting::Event Waiting::wait(int fd, int milliseconds) const {
  const std::uint64_t until =
      monotonic_ms() + static_cast<std::uint64_t>(std::max(milliseconds, 0));
  pollfd readable[] = {{signals_.get(), POLLIN, 0}, {fd, POLLIN, 0}};
  for (;;) {
    const std::uint64_t now = monotonic_ms();
    const int left = now >= until ? 0 : static_cast<int>(until - now);
    const int ready = ::poll(readable, 2, left);
    if (ready < 0 && errno == EINTR) continue;
    if (ready <= 0) return Event::time;
    return readable[0].revents != 0 ? Event::end : Event::input;
  }
}

}  // namespace agnocast::ctl
