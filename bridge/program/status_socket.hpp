// SPDX-License-Identifier: Apache-2.0
//
// StatusSocket: sends one text to each client that connects, then closes. A thread of its own
// sleeps in poll(). It writes without blocking to a few clients at a time, and drops those that do
// not read. It never reads what a client sends.
//
//   PATH        a stream socket with the mode of the daemon's: its group may read the status
//   PATH.lock   locked while the bridge lives, so that a domain has one bridge, which may replace
//               a socket that a dead one left
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <tl/expected.hpp>

#include <functional>
#include <memory>
#include <string>
#include <thread>

namespace agnocast::bridge {

class StatusSocket {
 public:
  struct Failure {
    bool is_taken = false;  ///< another bridge holds the lock
    std::string why;
  };
  /// Takes the lock beside the socket: one bridge holds it. Refuses a directory that other users
  /// may write.
  [[nodiscard]] static tl::expected<std::unique_ptr<StatusSocket>, Failure> take(
      const std::string& path);
  /// Call once. The thread calls `answer` at most every 50 ms.
  [[nodiscard]] tl::expected<void, Failure> listen(std::function<std::string()> answer);
  /// Removes the socket.
  ~StatusSocket();
  StatusSocket(const StatusSocket&) = delete;
  StatusSocket& operator=(const StatusSocket&) = delete;

 private:
  StatusSocket() = default;
  void serve();

  std::string path_;
  std::function<std::string()> answer_;
  UniqueFd lock_, socket_, stop_;
  std::thread thread_;
};

/// Returns the path of the socket: `named` (--status-socket or AGNOCAST_BRIDGE_SOCKET; empty:
/// neither), else one in the directory from systemd, else one beside the daemon's socket.
std::string choose_status_path(const std::string& named, std::uint32_t domain);

}  // namespace agnocast::bridge
