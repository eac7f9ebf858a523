// SPDX-License-Identifier: Apache-2.0

#include <dataplane/steps.hpp>
#include <tests/support/crash/crash_point.hpp>

#ifdef AGNOCAST_CRASH_POINTS

#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include <cstdlib>

namespace agnocast {
namespace {

using crash_points::Control;

constexpr std::uint64_t never = ~std::uint64_t{0};  // no Step, plus one

constinit Control own{};
constinit std::atomic<Control*> control{&own};

// splitmix64: neighbouring numbers give unrelated results.
std::uint64_t mixed(std::uint64_t x) noexcept {
  x += 0x9e3779b97f4a7c15;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9;
  x = (x ^ (x >> 27)) * 0x94d049bb133111eb;
  return x ^ (x >> 31);
}

void die(Control& told, Step step) noexcept {
  if (const std::uint64_t more = told.then.exchange(0, std::memory_order_relaxed); more != 0)
    told.deadly.fetch_add(more, std::memory_order_relaxed);
  told.last.store(static_cast<std::uint64_t>(step) + 1, std::memory_order_relaxed);
  ::kill(::getpid(), SIGKILL);
}

void jitter(Control& told, Step step, std::uint64_t seed, std::uint64_t n) noexcept {
  constexpr std::uint64_t million = 1'000'000;
  const std::uint64_t dice = mixed(seed ^ mixed(n));
  const std::uint64_t deaths = told.deaths.load(std::memory_order_relaxed);
  const std::uint64_t roll = dice % million;
  if (roll < deaths) die(told, step);
  if (roll >= deaths + told.sleeps.load(std::memory_order_relaxed)) return;
  // The product of two even distributions: half of the pauses are below a fifth of the longest.
  const std::uint64_t a = dice >> 32 & 0xffff, b = dice >> 48;
  const auto pause_ns = static_cast<long>(crash_points::jitter_ns_max * (a * b >> 16) >> 16);
  const timespec pause{0, pause_ns};
  ::nanosleep(&pause, nullptr);
}

void count_commit(Control& told, Step step) noexcept {
  thread_local Step before = no_step;
  if (before == steps::P5_head && ::gettid() == ::getpid())
    told.commits.fetch_add(1, std::memory_order_relaxed);
  before = step;
}

// Before main, so that the first point already counts.
[[gnu::constructor]] void find_control() noexcept {
  const char* const path = ::secure_getenv("AGNOCAST_CRASH_CONTROL");
  if (path == nullptr) return;
  const int file = ::open(path, O_RDWR | O_CLOEXEC);
  if (file < 0) return;
  void* const at = ::mmap(nullptr, sizeof(Control), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  ::close(file);
  if (at != MAP_FAILED) control.store(static_cast<Control*>(at), std::memory_order_relaxed);
}

}  // namespace

void crash_point(Step step) noexcept {
  Control& told = *control.load(std::memory_order_relaxed);
  count_commit(told, step);
  if (const std::uint64_t from = told.from.load(std::memory_order_relaxed); from != 0) {
    if (from != static_cast<std::uint64_t>(step) + 1) return;
    told.from.store(0, std::memory_order_relaxed);
  }
  if (told.until.load(std::memory_order_relaxed) == static_cast<std::uint64_t>(step) + 1) {
    told.until.store(0, std::memory_order_relaxed);
    told.from.store(never, std::memory_order_relaxed);
    return;
  }
  const std::uint64_t n = told.reached.fetch_add(1, std::memory_order_relaxed) + 1;
  if (n == told.deadly.load(std::memory_order_relaxed)) die(told, step);
  if (const std::uint64_t seed = told.seed.load(std::memory_order_relaxed); seed != 0)
    jitter(told, step, seed, n);
}

namespace crash_points {

void use(Control& told) noexcept { control.store(&told, std::memory_order_relaxed); }

void arm(std::uint64_t n) noexcept {
  Control& told = *control.load(std::memory_order_relaxed);
  told.reached.store(0, std::memory_order_relaxed);
  told.deadly.store(n, std::memory_order_relaxed);
}
std::uint64_t reached() noexcept {
  return control.load(std::memory_order_relaxed)->reached.load(std::memory_order_relaxed);
}

}  // namespace crash_points
}  // namespace agnocast

#endif
