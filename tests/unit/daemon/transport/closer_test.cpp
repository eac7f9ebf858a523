// SPDX-License-Identifier: Apache-2.0
//
// Goal: the closer closes each descriptor that it was given, but not before the service manager
// has closed its own copies. Method: our own service manager that takes its time; the write end of
// a pipe, whose reader sees the close.

#include <daemon/transport/closer.hpp>
#include <tests/unit/daemon/transport/service_manager.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstring>
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

TEST(Closer, ClosesAfterTheManagerHasClosedItsCopies) {
  const ServiceManager manager;
  Closer closer;
  for (int i = 0; i < 2; ++i) {  // the thread starts with the first and waits for the second
    Pipe pipe;
    closer.close({std::exchange(pipe.writer, nullptr)});
    Received barrier = manager.receive();
    ASSERT_EQ(barrier.text, "BARRIER=1");
    ASSERT_EQ(barrier.fds.size(), 1u);
    EXPECT_FALSE(pipe.is_closed(20));
    barrier.fds.clear();
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
