// SPDX-License-Identifier: Apache-2.0
//
// Goal: the closer closes each descriptor that it was given, but not before the service manager
// has closed its own copies. Method: our own service manager that takes its time; the write end of
// a pipe, whose reader sees the close.

#include <daemon/transport/closer.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>
#include <utility>

namespace agnocast::daemon {
namespace {

constexpr int patience_ms = 10'000;

struct Pipe {
  UniqueFd reader;
  SharedFd writer;
  Pipe() {
    int ends[2] = {-1, -1};
    EXPECT_EQ(::pipe2(ends, O_CLOEXEC), 0);
    reader.reset(ends[0]);
    writer = share(UniqueFd(ends[1]));
  }
  bool is_closed(int within_ms) const {
    pollfd entry{reader.get(), 0, 0};
    return ::poll(&entry, 1, within_ms) == 1 && (entry.revents & POLLHUP) != 0;
  }
};

/// The socket of a service manager, and the descriptor of the barrier sent to it.
class SilentManager {
 public:
  SilentManager() : socket_(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    socklen_t bytes = sizeof(sa_family_t);  // the kernel chooses an abstract name
    EXPECT_EQ(::bind(socket_.get(), reinterpret_cast<sockaddr*>(&address), bytes), 0);
    bytes = sizeof address;
    ::getsockname(socket_.get(), reinterpret_cast<sockaddr*>(&address), &bytes);
    address.sun_path[0] = '@';
    const std::string name(address.sun_path, bytes - offsetof(sockaddr_un, sun_path));
    ::setenv("NOTIFY_SOCKET", name.c_str(), 1);
    ::setenv("FDSTORE", "100", 1);
  }
  ~SilentManager() {
    ::unsetenv("NOTIFY_SOCKET");
    ::unsetenv("FDSTORE");
  }
  UniqueFd receive_barrier() const {
    pollfd entry{socket_.get(), POLLIN, 0};
    if (::poll(&entry, 1, patience_ms) != 1) return UniqueFd();
    std::array<char, 64> text{};
    iovec data{text.data(), text.size()};
    alignas(cmsghdr) std::array<char, 256> control{};
    msghdr message{};
    message.msg_iov = &data;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    EXPECT_GT(::recvmsg(socket_.get(), &message, MSG_CMSG_CLOEXEC), 0);
    EXPECT_STREQ(text.data(), "BARRIER=1");
    for (cmsghdr* part = CMSG_FIRSTHDR(&message); part != nullptr;
         part = CMSG_NXTHDR(&message, part)) {
      if (part->cmsg_type != SCM_RIGHTS) continue;
      int fd = -1;
      std::memcpy(&fd, CMSG_DATA(part), sizeof fd);
      return UniqueFd(fd);
    }
    return UniqueFd();
  }

 private:
  UniqueFd socket_;
};

TEST(Closer, ClosesAfterTheManagerHasClosedItsCopies) {
  const SilentManager manager;
  Closer closer;
  for (int i = 0; i < 2; ++i) {  // the thread starts with the first and waits for the second
    Pipe pipe;
    closer.close({std::exchange(pipe.writer, nullptr)});
    UniqueFd barrier = manager.receive_barrier();
    ASSERT_TRUE(barrier);
    EXPECT_FALSE(pipe.is_closed(20));
    barrier.reset();
    EXPECT_TRUE(pipe.is_closed(patience_ms));
  }
}

TEST(Closer, UnmapsTheGivenMapping) {
  constexpr std::uint64_t bytes = 40 << 20;
  const UniqueFd file(::memfd_create("filled", MFD_CLOEXEC));
  ASSERT_EQ(::ftruncate(file.get(), bytes), 0);
  Mapping mapping = std::move(*Mapping::map(file.get(), bytes, Mapping::Access::read_write));
  std::memset(mapping.base(), 1, bytes);
  ::mlock(mapping.base(), 4096);
  std::byte* const base = mapping.base();
  {
    Closer closer;
    closer.close({}, std::make_shared<Mapping>(std::move(mapping)));
  }
  unsigned char resident = 0;
  EXPECT_EQ(::mincore(base, 4096, &resident), -1);
  EXPECT_EQ(errno, ENOMEM) << "the memory must be unmapped";
}

TEST(Closer, ClosesRemainingDescriptorsBeforeItEnds) {
  Pipe pipe, other;
  {
    Closer closer;
    closer.close({std::exchange(pipe.writer, nullptr)});
    closer.close({std::exchange(other.writer, nullptr)});
  }
  EXPECT_TRUE(pipe.is_closed(0));
  EXPECT_TRUE(other.is_closed(0));
}

}  // namespace
}  // namespace agnocast::daemon
