// SPDX-License-Identifier: Apache-2.0
//
// Supervisor: keeps what must outlive the daemon where systemd does not.
//
//   agnocastd                        the supervisor: forks, keeps descriptors, waits
//     agnocastd --fd-store=manager   the worker: the daemon
//
// The worker sees it as systemd: descriptors come as datagrams at NOTIFY_SOCKET (FDSTORE=1,
// FDNAME=…) and go back as LISTEN_FDS, so the worker has one way for both. Only datagrams of the
// worker itself count. The socket has no name that another process could send to. A passed
// listening socket of the supervisor is passed on to every worker.
//
// A worker that ends by a signal or a failure is started again: at once the first time, then after
// a pause that doubles up to five seconds if it never was ready. After a worker that had been
// ready, the next one begins at the latest a tenth of a second after the previous start: a worker
// that lived longer is replaced at once, however often it dies. The supervisor never gives up: its
// descriptors cannot be made again, and a try every five seconds costs nothing; the log has each
// one. Only if a worker fails before any was ever ready, the supervisor ends with its status: then
// there is nothing to keep, and the parent process needs to know.
//
//   SIGTERM, SIGINT   the worker ends and removes what it made; the supervisor returns its status
//   SIGHUP            the worker ends and keeps everything; its program, perhaps a new one, starts
//
// A worker that hangs delays neither. Asked to end, its loop sends STOPPING=1 as soon as it sees
// the signal; a worker that sends nothing for stop_patience_ms is killed, which loses nothing that
// is kept. A worker that waits for a processor does not hang: that time does not count. While its
// loop runs it sends WATCHDOG=1, as to systemd with WatchdogSec=; a worker without it for [daemon]
// watchdog_seconds is killed and started again.
//
// A dead worker may stay in the kernel for as long as a client likes
// (base/descriptors/closing.hpp), without a report of its end. Then only a thread is left that
// holds nothing of the worker: its memory is gone and its descriptors are closed, as shown by a
// pipe with its other end among them. Then the next worker begins. (A pidfd of the first thread
// would show it on some kernels only, and reading /proc may block.)
//
// The worker never outlives the supervisor (PR_SET_PDEATHSIG): two daemons could not share the
// regions. No threads, no state but the descriptors; nothing in here can be wrong for long.
#pragma once

#include <base/descriptors/unique_fd.hpp>
#include <base/text/log.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace agnocast::daemon {

/// The content of one datagram of sd_notify(3); unknown lines are ignored.
struct Notification {
  bool ready = false;
  bool stopping = false;
  bool watchdog = false;  // WATCHDOG=1
  bool store = false;     // FDSTORE=1
  bool remove = false;    // FDSTOREREMOVE=1
  std::string name;       // FDNAME, "stored" when it is missing
  std::string status;
};
/// Parses a datagram. Returns nothing when it is invalid, or names a descriptor in a way that
/// cannot be passed on.
std::optional<Notification> parse_notification(std::string_view text);

/// Makes a worker of this supervisor die with it; call first. Returns false if the supervisor has
/// died already. Does nothing in other processes.
[[nodiscard]] bool die_with_supervisor() noexcept;

/// Runs until a signal ends it. Returns its exit status. The arguments are those of this process.
/// Kills a worker whose loop has not run for `watchdog_seconds` (0: never).
int supervise(int argc, const char* const* argv, std::uint32_t watchdog_seconds, Log& log);

}  // namespace agnocast::daemon
