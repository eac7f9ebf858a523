// SPDX-License-Identifier: Apache-2.0
//
// Peer process: a process of its own for the kernel (pid, pidfd, user, end), which shares memory
// and descriptors with this one (clone(2): CLONE_VM, CLONE_FILES). So agnocastd finds in it the
// mappings of this process, it starts in microseconds, and this process speaks for it.
#pragma once

#include <base/sockets/packet_socket.hpp>

#include <sys/types.h>

#include <string>

namespace agnocast::daemon::fuzz {

class PeerProcess {
 public:
  /// Starts it, as `uid` if this process is root.
  explicit PeerProcess(uid_t uid);
  PeerProcess(const PeerProcess&) = delete;
  PeerProcess& operator=(const PeerProcess&) = delete;
  /// Kills it and waits for its end.
  ~PeerProcess();

  /// Returns its user: that of this process where it may not have another one.
  uid_t uid() const;
  /// Connects to the listener at `path`: its end knows this process, not ours.
  PacketSocket connect(const std::string& path);

 private:
  struct Orders;

  Orders* orders_;
  pid_t pid_ = -1;
};

}  // namespace agnocast::daemon::fuzz
