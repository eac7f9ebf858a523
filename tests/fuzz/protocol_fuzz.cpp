// SPDX-License-Identifier: Apache-2.0
//
// Goal: no sequence of packets, deaths and stores of clients into their own regions brings the
// daemon's state machine into a wrong state. Method: the input is a list of steps of five
// processes of two users. Each packet goes through decode() to registry, endpoint manager and
// reaper over real regions; only sockets are missing. An oracle beside it knows only the packets:
// what each process was notified of and has not acknowledged.
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
//   fake_broker   the daemon without sockets, which serves it
//   processes     what each of the five has and was notified of
//   oracle        what the daemon may send and assign: RU, rejoin, revoke, complete answers
//   table_checks  board, restart, and that nothing is left when all are dead

#include <tests/fuzz/protocol/fake_broker.hpp>
#include <tests/fuzz/protocol/scenario.hpp>
#include <tests/fuzz/protocol/table_checks.hpp>

#include <fuzzer/FuzzedDataProvider.h>

#include <cstddef>
#include <cstdint>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace agnocast::daemon::fuzz;
  constexpr int step_count_max = 300;
  FuzzedDataProvider input(data, size);
  FakeBroker broker;
  Scenario scenario(input, broker);
  for (int step = 0; step < step_count_max && !scenario.is_over(); ++step) {
    scenario.step();
    check_board(broker.registry(), broker.memory());
  }
  check_restart(broker.registry(), broker.memory());
  for (Process& process : broker.processes()) broker.die(process);
  check_nothing_left(broker.registry(), broker.plan());
  return 0;
}
