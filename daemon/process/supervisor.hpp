// SPDX-License-Identifier: Apache-2.0
//
// Supervisor: keeps what must outlive the daemon where systemd does not.
//
//   agnocastd                        the supervisor: forks, keeps descriptors, waits
//     agnocastd --fd-store=manager   the worker: the daemon
//
// To the worker it is what systemd is: descriptors come as datagrams at NOTIFY_SOCKET (FDSTORE=1,
// FDNAME=…) and go back as LISTEN_FDS, so the worker has one way for both. Only datagrams of the
// worker itself count. The socket has no name that anybody else could send to. A socket to listen
// at that was passed to the supervisor is passed on to every worker.
//
// A worker that ends by a signal or a failure is started again, at once the first time, then after
// a pause that doubles: up to five seconds if it never was ready. One that had been ready begins a
// tenth of a second after the former one's start at the latest, so what lived longer is replaced at
// once however often it dies. It is never given up: what is kept here cannot be got back, and a try
// every five seconds costs nothing; the log says each one. Only a worker that fails before
// any has ever been ready ends the supervisor, with its status: then nothing is kept, and whoever
// started us wants to know.
//
//   SIGTERM, SIGINT   the worker ends and removes what it made; its status is ours
//   SIGHUP            the worker ends, keeps everything, and its program is started anew: a
//   replaced
//                     one takes over
//
// A worker that hangs holds up neither. Told to end, it says STOPPING=1 as soon as its loop hears
// of it; one that says nothing for stop_patience_ms is killed, which costs nothing that is kept.
// And it says WATCHDOG=1 while its loop turns, as to systemd with WatchdogSec=; one that has not
// for [daemon] watchdog_seconds is killed and started again.
//
// A dead worker may stay in the kernel for as long as a client likes
// (base/descriptors/closing.hpp), and then nobody is told of its end. What is kept there is a
// thread that holds nothing of the worker: its memory is gone, and its descriptors are closed,
// which a pipe says whose other end is one of them. Then the next worker begins. (A pidfd of the
// first thread would say it on some kernels only, and /proc is of no use to somebody who must not
// wait.)
//
// The worker never outlives the supervisor (PR_SET_PDEATHSIG): two daemons could not share the
// regions. No thread, no state but the descriptors; nothing in here can be wrong for long.
#pragma once

#include <base/descriptors/unique_fd.hpp>
#include <base/text/log.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace agnocast::daemon {

/// What one datagram of sd_notify(3) asks for; what we do not know is passed over.
struct Notification {
  bool ready = false;
  bool stopping = false;
  bool watchdog = false;  // WATCHDOG=1
  bool store = false;     // FDSTORE=1
  bool remove = false;    // FDSTOREREMOVE=1
  std::string name;       // FDNAME, "stored" when it is not said
  std::string status;
};
/// Nothing when it is no such datagram, or gives a descriptor a name that cannot be passed on.
std::optional<Notification> parse_notification(std::string_view text);

/// Of a worker of ours, as the first thing: it is not to outlive its supervisor. False: the
/// supervisor has died already. Of any other process: nothing.
[[nodiscard]] bool die_with_supervisor() noexcept;

/// Runs until it is told to end; its exit status. The arguments are those of this process. A worker
/// that has not turned its loop for so many seconds hangs (0: nobody looks).
int supervise(int argc, const char* const* argv, std::uint32_t watchdog_seconds, Log& log);

}  // namespace agnocast::daemon
