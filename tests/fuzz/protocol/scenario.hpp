// SPDX-License-Identifier: Apache-2.0
//
// Scenario: the input, read as steps of processes. A step is a packet, the end of a connection or
// of a process, a store into a region, or a packet of the observer.
//
// Raw bytes would seldom get past decode(). So most packets are about what their sender has or was
// notified of, some with a wrong word; now and then they are random. The kept inputs
// (corpus/protocol) change their meaning when a draw is added, removed or moved.
#pragma once

#include <tests/fuzz/protocol/daemon_loop.hpp>
#include <tests/fuzz/protocol/processes.hpp>

#include <fuzzer/FuzzedDataProvider.h>

#include <cstddef>
#include <cstdint>
#include <iterator>

namespace agnocast::daemon::fuzz {

class Scenario {
 public:
  Scenario(FuzzedDataProvider& input, DaemonLoop& daemon) : input_(input), daemon_(daemon) {}

  bool is_over() const { return input_.remaining_bytes() == 0; }
  void step();

 private:
  // --- a client's packets
  void say(Process& process);
  void say_anything(Process& process);
  void say_right_in_length(Process& process);
  void say_first(Process& process);
  void say_hello(Process& process);
  void say_rejoin(Process& process, const Process& as);
  void say_open_window(Process& process);
  void say_bring_window(Process& process);
  void say_blocked(Process& process);
  void say_open_executor(Process& process);
  void say_create(Process& process);
  void say_leave_or_drained(Process& process);
  void say_unlinked_endpoint(Process& process);
  void say_unlinked_region(Process& process);
  void say_unlinked(Process& process, const Announced& subject, std::uint64_t generation);
  /// `id`: 0 takes the next one.
  template <class Body>
  void ask(Process& from, Opcode opcode, Body body, std::uint64_t id = 0) {
    body.header = {opcode, sizeof body, id != 0 ? id : ++last_request_};
    // As if the sender did not know whether the first one had arrived.
    if (up_to(15) == 0) body.header.request |= wire::asked_again;
    daemon_.serve(from, packet_of(body));
  }
  BroughtWindow draw_former_window(const Process& process);

  void watch();
  void store(const Process& process);

  // --- draws from the input
  std::uint64_t up_to(std::uint64_t last) {
    return input_.ConsumeIntegralInRange<std::uint64_t>(0, last);
  }
  std::uint64_t any_word() { return input_.ConsumeIntegral<std::uint64_t>(); }
  bool rarely() { return up_to(7) == 0; }
  template <class Container>
  auto& one_of(Container& container) {
    return *std::next(std::begin(container),
                      static_cast<std::ptrdiff_t>(up_to(std::size(container) - 1)));
  }
  Process& any_process() { return one_of(daemon_.processes()); }
  Process& mostly(Process& process) { return rarely() ? any_process() : process; }

  FuzzedDataProvider& input_;
  DaemonLoop& daemon_;
  std::uint64_t last_request_ = 0;
};

}  // namespace agnocast::daemon::fuzz
