// SPDX-License-Identifier: Apache-2.0
//
// StatusSocket: gives who connects one text, then closes. A thread of its own sleeps in poll() until somebody comes;
// it writes without waiting, to a few at a time, and gives up on who does not read. What a client sends is not read.
//
//   PATH        a stream socket, for the group: who may look at the daemon may look at the bridge
//   PATH.lock   locked as long as the bridge lives, so that there is one of a domain, and a socket that a dead one
//               left can be replaced
#pragma once

#include <base/unique_fd.hpp>

#include <tl/expected.hpp>

#include <functional>
#include <memory>
#include <string>
#include <thread>

namespace agnocast::bridge {

class StatusSocket {
 public:
  struct Failure {
    bool is_taken = false;  ///< another bridge has it
    std::string why;
  };
  /// Takes the lock beside it: one bridge has it. Refuses a directory in which other users could replace either.
  [[nodiscard]] static tl::expected<std::unique_ptr<StatusSocket>, Failure> take(
      const std::string& path);
  /// Once. `answer` is called by the thread, at most every 50 ms.
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

/// --status-socket or AGNOCAST_BRIDGE_SOCKET (`named`; empty: neither), else in the directory that systemd made for
/// us, else beside the daemon's socket.
std::string choose_status_path(const std::string& named, std::uint32_t domain);

}  // namespace agnocast::bridge
