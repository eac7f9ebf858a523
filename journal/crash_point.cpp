// SPDX-License-Identifier: Apache-2.0

#include <journal/crash_point.hpp>

#ifdef AGNOCAST_CRASH_POINTS

#include <signal.h>
#include <unistd.h>

#include <atomic>

namespace agnocast {
namespace {

std::atomic<std::uint64_t> deadly{0};
std::atomic<std::uint64_t> count{0};

}  // namespace

void crash_point(Step) noexcept {
  if (count.fetch_add(1, std::memory_order_relaxed) + 1 == deadly.load(std::memory_order_relaxed))
    ::kill(::getpid(), SIGKILL);
}

namespace crash_points {

void arm(std::uint64_t n) noexcept {
  count.store(0, std::memory_order_relaxed);
  deadly.store(n, std::memory_order_relaxed);
}
std::uint64_t reached() noexcept { return count.load(std::memory_order_relaxed); }

}  // namespace crash_points
}  // namespace agnocast

#endif
