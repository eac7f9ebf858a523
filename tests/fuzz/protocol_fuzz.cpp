// SPDX-License-Identifier: Apache-2.0
//
// Goal: no sequence of packets, deaths and stores of clients into their own regions brings the
// daemon into a wrong state. Method: the input is a list of steps of five processes of two users,
// which connect to the broker of agnocastd in this process, with its listener, its threads and its
// quotas. An oracle beside it knows only the packets: what each process was notified of and has
// not acknowledged. From the tables it learns only of a revocation that a process without a
// connection cannot hear of.
//   rule RU   no place, extent, process index or window is reused while a process that was
//             notified of the previous one has not acknowledged its end
//   board     agrees with the tables about every endpoint
//   restart   a registry opened on the memory finds the same state as the one that wrote it
//   matching  a new endpoint, and a process that reconnects, are notified of exactly the endpoints
//             that match; a subscription may ignore those of its own process
//   rejoin    a process that reconnects after a lost connection is notified of the same as before;
//             no process gets the place of another, and a revoked one does not get its own
//   revoke    a revoked process keeps its place and its windows until it ends
//   observers always get complete answers
// The daemon's own invariants abort it.
//
// This file is only the entry point. In protocol/:
//   scenario      the input as steps: packets, stores, ends
//   daemon_loop   the daemon, and the connections to it
//   processes     what each of the five has and was notified of
//   peer_process  a process for the kernel, without memory of its own
//   oracle        what the daemon may send and assign: RU, rejoin, revoke, complete answers
//   table_checks  board, restart, and that nothing is left when all are dead

#include <tests/fuzz/protocol/daemon_loop.hpp>
#include <tests/fuzz/protocol/scenario.hpp>
#include <tests/fuzz/protocol/table_checks.hpp>

#include <fuzzer/FuzzedDataProvider.h>

#include <sys/socket.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>

extern "C" int LLVMFuzzerInitialize(int*, char***) {
  // Before that the sender of a packet has to be the process that connected; here one process sends
  // for all.
  constexpr int so_peerpidfd = 77;
  int ends[2], process = -1;
  socklen_t bytes = sizeof process;
  if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) != 0 ||
      ::getsockopt(ends[0], SOL_SOCKET, so_peerpidfd, &process, &bytes) != 0) {
    std::puts("SKIPPED: SO_PEERPIDFD needs Linux 6.5");
    std::exit(77);
  }
  for (const int fd : {ends[0], ends[1], process}) ::close(fd);
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace agnocast::daemon::fuzz;
  constexpr int step_count_max = 300;
  FuzzedDataProvider input(data, size);
  DaemonLoop daemon;
  Scenario scenario(input, daemon);
  for (int step = 0; step < step_count_max && !scenario.is_over(); ++step) {
    scenario.step();
    check_board(daemon.registry(), daemon.tables());
  }
  check_restart(daemon.registry(), daemon.tables());
  for (Process& process : daemon.processes()) daemon.die(process);
  check_nothing_left(daemon.registry(), daemon.plan());
  return 0;
}
