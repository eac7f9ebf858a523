// SPDX-License-Identifier: Apache-2.0
//
// For LD_PRELOAD: after SIGUSR1 the allocation with the number in AGNOCAST_NO_MEMORY fails, once,
// in any thread; stderr reports it.

#include <dlfcn.h>
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdlib>
#include <new>

namespace {

constexpr char said[] = "no memory here\n";
std::atomic<long> left{-1};

[[gnu::constructor]] void listen() {
  static const long number = std::atol(std::getenv("AGNOCAST_NO_MEMORY"));
  std::signal(SIGUSR1, [](int) { left = number; });
}

}  // namespace

void* operator new(std::size_t bytes) {
  using New = void* (*)(std::size_t);
  static const New next = reinterpret_cast<New>(::dlsym(RTLD_NEXT, "_Znwm"));
  if (left >= 0 && left.fetch_sub(1) == 0) {
    [[maybe_unused]] const ssize_t written = ::write(STDERR_FILENO, said, sizeof said - 1);
    throw std::bad_alloc();
  }
  return next(bytes);
}
