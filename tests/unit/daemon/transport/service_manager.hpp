// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>

#include <array>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

namespace agnocast::daemon {

/// A datagram to a service manager, with the descriptors in it.
struct Received {
  std::string text;
  std::vector<UniqueFd> fds;
};

/// The socket of a service manager that keeps up to 100 descriptors (sd_notify(3)); the environment
/// names it while the object exists.
class ServiceManager {
 public:
  ServiceManager() {
    const UniqueFd made(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
    socket_.reset(::fcntl(made.get(), F_DUPFD_CLOEXEC, 32));  // above those passed on
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    socklen_t bytes = sizeof(sa_family_t);  // the kernel chooses an abstract name
    EXPECT_EQ(::bind(socket_.get(), reinterpret_cast<sockaddr*>(&address), bytes), 0);
    bytes = sizeof address;
    ::getsockname(socket_.get(), reinterpret_cast<sockaddr*>(&address), &bytes);
    const timeval patience{300, 0};
    ::setsockopt(socket_.get(), SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    address.sun_path[0] = '@';
    const std::string name(address.sun_path, bytes - offsetof(sockaddr_un, sun_path));
    ::setenv("NOTIFY_SOCKET", name.c_str(), 1);
    ::setenv("FDSTORE", "100", 1);
  }
  ~ServiceManager() {
    ::unsetenv("NOTIFY_SOCKET");
    ::unsetenv("FDSTORE");
  }
  /// Waits for the next datagram, for minutes at most; without one the text is empty.
  Received receive() const {
    Received received;
    std::array<char, 512> text{};
    iovec data{text.data(), text.size()};
    alignas(cmsghdr) std::array<char, 256> control{};
    msghdr message{};
    message.msg_iov = &data;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    const ssize_t bytes = ::recvmsg(socket_.get(), &message, MSG_CMSG_CLOEXEC);
    if (bytes > 0) received.text.assign(text.data(), static_cast<std::size_t>(bytes));
    for (cmsghdr* part = CMSG_FIRSTHDR(&message); part != nullptr;
         part = CMSG_NXTHDR(&message, part)) {
      if (part->cmsg_type != SCM_RIGHTS) continue;
      for (std::size_t i = 0; i < (part->cmsg_len - CMSG_LEN(0)) / sizeof(int); ++i) {
        int fd = -1;
        std::memcpy(&fd, CMSG_DATA(part) + i * sizeof fd, sizeof fd);
        received.fds.emplace_back(fd);
      }
    }
    return received;
  }

 private:
  UniqueFd socket_;
};

}  // namespace agnocast::daemon
