// SPDX-License-Identifier: Apache-2.0
//
// Goal: after a caller hands over a datagram to discard, it may reuse the descriptor number at
// once, however late the discarding thread runs. Method: this program's own syscall(), which
// delays that thread before its first step.

#include <base/descriptors/closing.hpp>

#include <dlfcn.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <chrono>
#include <cstdarg>
#include <filesystem>
#include <iterator>
#include <thread>

namespace {
std::atomic<bool> is_slow = false;
}

// Reads six arguments whatever the call has, as the kernel does.
extern "C" [[gnu::no_sanitize_address]] long syscall(long number, ...) noexcept {
  static const auto real = reinterpret_cast<long (*)(long, ...)>(::dlsym(RTLD_NEXT, "syscall"));
  if (number == SYS_close_range && is_slow) ::usleep(1'000'000);
  va_list list;
  va_start(list, number);
  std::array<long, 6> a{};
  for (long& argument : a) argument = va_arg(list, long);
  va_end(list);
  return real(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}

namespace agnocast {
namespace {

std::array<UniqueFd, 2> doorbell() {
  int ends[2];
  EXPECT_EQ(::socketpair(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0, ends), 0);
  return {UniqueFd(ends[0]), UniqueFd(ends[1])};
}

TEST(Closing, DiscardsADatagramOnlyFromItsOwnSocket) {
  auto first = doorbell(), second = doorbell();
  const int number = first[1].get();
  ASSERT_EQ(::send(first[0].get(), "1", 1, 0), 1);
  ASSERT_EQ(::send(second[0].get(), "2", 1, 0), 1);
  is_slow = true;
  EXPECT_TRUE(throw_datagram_away(number));
  ASSERT_EQ(::dup2(second[1].get(), number), number);
  const auto threads = [] {
    return std::distance(std::filesystem::directory_iterator("/proc/self/task"), {});
  };
  for (int round = 0; round < 10'000 && threads() > 1; ++round)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  char word = 0;
  EXPECT_EQ(::recv(number, &word, 1, MSG_DONTWAIT), 1)
      << "the datagram was taken from another socket";
  EXPECT_EQ(word, '2');
}

}  // namespace
}  // namespace agnocast
