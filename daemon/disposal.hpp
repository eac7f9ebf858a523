// SPDX-License-Identifier: Apache-2.0
//
// Disposal: closes what a client sent, and the connections it may have sent something on.
//
// A close may last as long as the client likes (base/closing.hpp). Nothing of that happens in the loop. The loop
// shuts a connection, so that the other end hears of it at once and can send nothing more; an errand closes it.
//
// Where the kernel refuses descriptors (SO_PASSRIGHTS, Linux 6.16) nothing is queued, and callers close in place.
//
// What cannot be hurried at all (writing back to a FUSE server that does not answer) keeps one thread of its
// sender's user. What this user has waiting is bounded by is_full().
#pragma once

#include <base/unique_fd.hpp>
#include <daemon/errands.hpp>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

namespace agnocast::daemon {

class Disposal {
 public:
  /// Connections of one user that wait to be closed. Who has as many has one that does not come to an end.
  static constexpr std::size_t waiting_max = 1'024;

  explicit Disposal(Errands& errands);

  /// Takes over a connection that nothing is read from any more; shuts it now and closes it soon.
  void close_connection(std::uint32_t uid, UniqueFd connection);
  /// Takes over descriptors that came out of a connection.
  void close_received(std::uint32_t uid, std::vector<UniqueFd> fds);
  /// How many connections of this user wait.
  std::size_t waiting(std::uint32_t uid) const;
  bool is_full(std::uint32_t uid) const { return waiting(uid) >= waiting_max; }

 private:
  struct State;
  static void close_some(State& state, std::uint32_t uid);

  Errands& errands_;
  std::shared_ptr<State> state_;  // shared with errands
};

}  // namespace agnocast::daemon
