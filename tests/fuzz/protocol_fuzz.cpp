// SPDX-License-Identifier: Apache-2.0
//
// Goal: no sequence of packets, deaths and stores of clients into their own regions brings the
// daemon's state machine into a state that is wrong.
// Method: the input is a list of steps of five processes of two users. Each packet goes through
// decode() and on to registry, membership and reaper over real regions; only sockets are missing.
// An oracle beside it knows nothing but the packets: what each process was told and has not let go
// of.
//   rule RU   no place, extent, process index or window is given out while somebody who was told of
//             the former one has not let go of it
//   board     says of every endpoint what the tables say
//   restart   a registry opened on the memory finds the same as the one that wrote it
//   rejoin    a process that lost its connection and has come back is told what it was told before;
//             nobody gets the place of another, nor one that was revoked its own
//   revoke    the place and the windows of one that was revoked stay its own until its process ends
//   observers are answered whole, whatever there is
// Invariants of the daemon's own abort in it.
//
// Here is the entry point alone. In protocol/:
//   scenario      the input as steps: what is said, stored, ended
//   fake_broker   the daemon without sockets, which serves it
//   processes     what each of the five has and was told
//   oracle        what the daemon may say and give: rules RU, rejoin, revoke, and whole answers
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
