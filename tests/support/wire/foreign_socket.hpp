// SPDX-License-Identifier: Apache-2.0
//
// ForeignSocket: another process's connection to agnocastd, without its knowledge. The test takes
// a copy of the descriptor (pidfd_getfd), so it can end the connection at any moment, and see
// whether all sent data has been read.
#pragma once

#include <base/descriptors/pidfd.hpp>
#include <base/descriptors/unique_fd.hpp>

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
  /// Finds the SOCK_SEQPACKET socket of a child of this process. Empty if it has none.
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

  /// The other end can still read what was sent before; the answer cannot arrive.
  bool end_connection() { return ::shutdown(socket_.get(), SHUT_RDWR) == 0; }
  /// Returns whether sent data is still unread.
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
