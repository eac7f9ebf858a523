// SPDX-License-Identifier: Apache-2.0
//
// ForeignSocket: the connection to agnocastd of another process, which knows nothing of it. The
// test takes a copy of the descriptor (pidfd_getfd), so it may end the connection at any moment,
// and see whether everything that was sent on it has been read.
#pragma once

#include <base/pidfd.hpp>
#include <base/unique_fd.hpp>

#include <dirent.h>
#include <linux/sockios.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cstdlib>
#include <string>

namespace agnocast::test {

class ForeignSocket {
 public:
  /// Of a child of this process: its socket of type SOCK_SEQPACKET. Empty when it has none.
  explicit ForeignSocket(pid_t pid) {
    const auto process = Pidfd::open(pid);
    DIR* const directory = ::opendir(("/proc/" + std::to_string(pid) + "/fd").c_str());
    if (!process || directory == nullptr) return;
    while (const dirent* const entry = ::readdir(directory)) {
      UniqueFd copy(
          static_cast<int>(::syscall(SYS_pidfd_getfd, process->fd(), std::atoi(entry->d_name), 0)));
      int type = 0;
      socklen_t bytes = sizeof type;
      if (copy && ::getsockopt(copy.get(), SOL_SOCKET, SO_TYPE, &type, &bytes) == 0 &&
          type == SOCK_SEQPACKET)
        socket_ = std::move(copy);
    }
    ::closedir(directory);
  }
  explicit operator bool() const noexcept { return static_cast<bool>(socket_); }

  /// What was sent before can still be read at the other end; the answer to it cannot come.
  bool end_connection() { return ::shutdown(socket_.get(), SHUT_RDWR) == 0; }
  /// Something was sent that nobody has read.
  bool has_unread() const {
    int bytes = 0;
    return ::ioctl(socket_.get(), SIOCOUTQ, &bytes) == 0 && bytes > 0;
  }

 private:
  UniqueFd socket_;
};

/// Ends the connection of a child of this process.
inline bool end_connection(pid_t pid) {
  ForeignSocket socket(pid);
  return socket && socket.end_connection();
}

}  // namespace agnocast::test
