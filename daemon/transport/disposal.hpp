// SPDX-License-Identifier: Apache-2.0
//
// Disposal: closes descriptors that clients sent, and connections that may carry some.
//
// A close may last as long as the client likes (base/descriptors/closing.hpp), so none happens in
// the loop. The loop shuts a connection down, which notifies the other end at once and stops
// further packets; an errand hands it to a thread that ends, one after the other for each user:
//
//   close_connection(uid) ──▶ waiting of this user ──▶ batch ──▶ thread that ends ──▶ the next batch
//
// A close that cannot be hurried (a FUSE server that does not answer) keeps one such thread and
// nothing else: the thread has a descriptor table of its own. When its user has waiting_max
// descriptors waiting, another thread gets them, so they never use up the daemon's descriptor
// numbers. No other user waits for any of it.
//
// If the kernel refuses descriptors (SO_PASSRIGHTS, Linux 6.16), nothing is queued, and callers
// close in place. If a filter forbids such threads, the user's errand closes in the daemon's
// table.
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
  /// Descriptors of one user that wait behind one whose close does not return. A thread costs the
  /// kernel as much as some ten connections.
  static constexpr std::size_t waiting_max = 512;
  /// Threads of one user that may be stuck with descriptors that came beside a window.
  static constexpr std::size_t receiving_max = 8;
  /// Packets of one user that wait to be received. A process sends one after the other.
  static constexpr std::size_t receiving_waiting_max = 64;

  /// `errands`: a pool of its own, so that errands of other kinds do not delay it.
  explicit Disposal(Errands& errands);

  /// Takes over a connection that is no longer read; shuts it down now and closes it soon.
  void close_connection(std::uint32_t uid, UniqueFd connection);
  /// Takes over a descriptor and closes it without a shutdown, because others may have it as well.
  void close(std::uint32_t uid, UniqueFd fd);
  /// Takes over memory that a client sent: freeing it may take long, but no client can delay it.
  void close_memory(std::uint32_t uid, UniqueFd memory);

  /// Returns whether a packet with descriptors may be received for this user.
  bool may_receive(std::uint32_t uid);
  /// Receives a packet in another thread, then calls `then` in the loop. `connection`: another
  /// descriptor of it.
  struct Received {
    std::vector<std::byte> bytes;
    ReceivedMemory memory;
  };
  void receive(std::uint32_t uid, PacketSocket connection, std::size_t bytes_max,
               std::function<void(Received&)> then);

  /// Returns how many threads of this user have not ended while others waited for them.
  std::size_t stuck(std::uint32_t uid) const;

 private:
  struct State;
  static void close_what_waits(State& state);
  void close_in_place();

  Errands& errands_;
  std::shared_ptr<State> state_;  // shared with errands
};

}  // namespace agnocast::daemon
