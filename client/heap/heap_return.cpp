// SPDX-License-Identifier: Apache-2.0

#include <base/immortal.hpp>
#include <base/text/text.hpp>
#include <client/heap/heap_return.hpp>
#include <client/process/library_thread.hpp>

#include <pthread.h>
#include <sched.h>

#include <algorithm>
#include <charconv>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>
#include <thread>

namespace agnocast {
namespace {

constexpr std::chrono::seconds idle_time_default{10};
constexpr std::uint64_t idle_seconds_max = 1'000'000;  // eleven days
// Less is not worth the system calls, nor the later page faults.
constexpr std::uint64_t much_bytes = std::uint64_t{4} << 20;
// Ten checks in the time, but not so often that the thread is busy, nor so rarely that it is
// late.
constexpr std::chrono::milliseconds pause_min{100}, pause_max{1000};

}  // namespace

HeapReturn& HeapReturn::instance() noexcept { return immortal<HeapReturn>(); }

Result<std::optional<std::chrono::seconds>> HeapReturn::idle_time() {
  const char* const text = ::secure_getenv("AGNOCAST_HEAP_IDLE_SECONDS");
  const std::string_view word = text != nullptr ? text : "";
  if (word.empty()) return idle_time_default;
  if (word == "never") return std::nullopt;
  std::uint64_t seconds = 0;
  const auto [stop, problem] = std::from_chars(word.data(), word.data() + word.size(), seconds);
  if (problem == std::errc() && stop == word.data() + word.size() && seconds > 0 &&
      seconds <= idle_seconds_max)
    return std::chrono::seconds(seconds);
  return fail_with(Errc::invalid_argument, "AGNOCAST_HEAP_IDLE_SECONDS is " + in_quotes(word) +
                                               ", which is neither a number of seconds from 1 to " +
                                               std::to_string(idle_seconds_max) + " nor never");
}

void HeapReturn::begin(const agnocast_heaphook_table& hook,
                       std::chrono::seconds idle_time) noexcept {
  idle_time_ = idle_time;
  hook_.store(&hook, std::memory_order_release);
}

std::chrono::milliseconds HeapReturn::pause() const noexcept {
  return std::clamp(std::chrono::milliseconds(idle_time_) / 10, pause_min, pause_max);
}

bool HeapReturn::has_much() const noexcept {
  return hook_.load(std::memory_order_relaxed)->idle() >= much_bytes;
}

void HeapReturn::look() noexcept {
  if (hook_.load(std::memory_order_acquire) == nullptr) return;
  const std::unique_lock lock(looking_, std::try_to_lock);
  // While the purge thread watches, it makes the checks, which may take as long as a purge does.
  if (!lock || watches_.load(std::memory_order_acquire)) return;
  const Clock::time_point now = Clock::now();
  if (now < next_look_) return;
  next_look_ = now + pause_max;
  if (!has_much()) return;
  watches_.store(true, std::memory_order_release);
  if (has_thread_) {
    watches_.notify_one();
    return;
  }
  has_thread_ = LibraryThread::start(
                    "agnocast-purge",
                    [](void* self) -> void* {
                      static_cast<HeapReturn*>(self)->serve();
                      return nullptr;
                    },
                    this) == 0;
  if (!has_thread_) watches_.store(false, std::memory_order_release);  // retry at a later look
}

/// Wakes the thread, which checks whether it must end.
void HeapReturn::end() noexcept {
  watches_.store(true, std::memory_order_release);
  watches_.notify_one();
}

void HeapReturn::serve() noexcept {
  const LibraryThread registered([](void* self) noexcept { static_cast<HeapReturn*>(self)->end(); },
                                 this);
  // The first publisher may have been made by a real-time thread, whose priority was inherited.
  const sched_param ordinary{};
  ::pthread_setschedparam(::pthread_self(), SCHED_OTHER, &ordinary);
  for (;;) {
    watches_.wait(false, std::memory_order_acquire);
    if (LibraryThread::is_over()) return;
    watch();
    if (LibraryThread::is_over()) return;
    watches_.store(false, std::memory_order_release);
  }
}

void HeapReturn::watch() noexcept {
  const Clock::time_point end = Clock::now() + idle_time_;
  do {
    std::this_thread::sleep_for(pause());
    if (!has_much() || LibraryThread::is_over()) return;
  } while (Clock::now() < end);
  hook_.load(std::memory_order_relaxed)->purge();
}

}  // namespace agnocast
