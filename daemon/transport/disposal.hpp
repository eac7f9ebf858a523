// SPDX-License-Identifier: Apache-2.0
//
// Disposal: closes what a client sent, and the connections it may have sent something on.
//
// A close may last as long as the client likes (base/descriptors/closing.hpp). Nothing of that
// happens in the loop. The loop shuts a connection, so that the other end hears of it at once and
// can send nothing more; an errand hands it to a thread that ends, one after the other for each
// user:
//
//   close_connection(uid) ──▶ waiting of this user ──▶ batch ──▶ thread that ends ──▶ the next batch
//
// What cannot be hurried at all (a FUSE server that does not answer) keeps one such thread, and
// nothing else: it has a descriptor table of its own. What its user has waiting meanwhile is given
// to another one when it is waiting_max, so it never takes up the numbers of the daemon. No other
// user waits for any of it.
//
// Where the kernel refuses descriptors (SO_PASSRIGHTS, Linux 6.16) nothing is queued, and callers
// close in place. Where a filter forbids such threads, an errand of this user's own closes in the
// daemon's table.
#pragma once

#include <base/descriptors/closing.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <daemon/transport/errands.hpp>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

namespace agnocast::daemon {

class Disposal {
 public:
  /// Descriptors of one user that wait behind one that does not come to its end. A thread costs the
  /// kernel as much as some ten connections.
  static constexpr std::size_t waiting_max = 512;
  /// Threads of one user that may be stuck with what came beside a window.
  static constexpr std::size_t receiving_max = 8;
  /// Packets of one user that wait to be received. A process sends one after the other.
  static constexpr std::size_t receiving_waiting_max = 64;

  /// `errands`: its own, so that nobody else's keep it waiting.
  explicit Disposal(Errands& errands);

  /// Takes over a connection that nothing is read from any more; shuts it now and closes it soon.
  void close_connection(std::uint32_t uid, UniqueFd connection);
  /// Takes over a descriptor that is not to be shut, because others may have it as well.
  void close(std::uint32_t uid, UniqueFd fd);
  /// Takes over memory that a client sent: much may go with it, but closing it waits for nobody.
  void close_memory(std::uint32_t uid, UniqueFd memory);

  /// Whether this user may have a packet with descriptors received.
  bool may_receive(std::uint32_t uid);
  /// Receives it elsewhere, and calls `then` in the loop. `connection`: another descriptor of it.
  struct Received {
    std::vector<std::byte> bytes;
    ReceivedMemory memory;
  };
  void receive(std::uint32_t uid, PacketSocket connection, std::size_t bytes_max,
               std::function<void(Received&)> then);

  /// Threads of this user that have not come to their end while others waited for it.
  std::size_t stuck(std::uint32_t uid) const;

 private:
  struct State;
  static void close_what_waits(State& state);
  void close_in_place();

  Errands& errands_;
  std::shared_ptr<State> state_;  // shared with errands
};

}  // namespace agnocast::daemon
