// SPDX-License-Identifier: Apache-2.0
//
// SoakBoard: the record of all processes of the soak, in memory that outlives each of them:
// committed messages, verified messages, and the first complaints. A killed process loses none of
// its findings.
#pragma once

#include <agnocast/error.hpp>
#include <tests/support/crash/crash_point.hpp>

#include <sys/mman.h>
#include <time.h>

#include <atomic>
#include <cstdarg>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>

namespace agnocast::test {

// Nanoseconds.
inline constexpr std::uint64_t millisecond = 1'000'000;
inline constexpr std::uint64_t second = 1000 * millisecond;

using Word = std::atomic<std::uint64_t>;

inline std::uint64_t now_ns() noexcept {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<std::uint64_t>(now.tv_sec) * 1'000'000'000 +
         static_cast<std::uint64_t>(now.tv_nsec);
}

/// Topics of the soak, each with its quality of service (soak_client.cpp).
enum class SoakTopic : std::uint64_t { last, deep, history, complete, effort, large, mixed, count };

/// One publisher; records are never reused.
struct PublisherRecord {
  Word topic;      // SoakTopic + 1
  Word born_ns;    // before its creation was requested
  Word attempted;  // messages: before publish is called
  Word committed;  // after it returned
};

/// One place, which one process has at a time.
struct SoakPlace {
  crash_points::Control control;
  Word joined;      // it has its first endpoint
  Word publishers;  // endpoints that it has ever had in its life
  Word subscriptions;
  Word reading_token, reading_number;  // the message under verification
  Word looks;                          // grows as long as its loop runs
  Word waits_for;                      // a resident: the Phase that it is ready for
};

struct SoakBoard {
  static constexpr std::uint64_t publisher_count_max = 1 << 23;
  static constexpr std::size_t place_count_max = 64;
  static constexpr std::size_t complaint_count_max = 32;
  static constexpr std::size_t code_count_max = 64;

  enum Phase : std::uint64_t { assemble, run, silence, drain, unsubscribe, unpublish, end };
  Word phase;

  Word publisher_count;
  Word published, taken, released, verified_bytes, lost, adopted;
  Word wrong;                    // messages with a wrong byte
  Word refused[code_count_max];  // publish and create, by error code
  Word complaint_count;
  char complaint[complaint_count_max][400];

  SoakPlace place[place_count_max];
  PublisherRecord publisher[publisher_count_max];  // pages are allocated as they are used

  static SoakBoard& make() {
    void* const memory = ::mmap(nullptr, sizeof(SoakBoard), PROT_READ | PROT_WRITE,
                                MAP_SHARED | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (memory == MAP_FAILED) std::abort();
    return *static_cast<SoakBoard*>(memory);
  }

  [[gnu::format(printf, 2, 3)]] void complain(const char* format, ...) noexcept {
    const std::uint64_t index = complaint_count.fetch_add(1);
    if (index >= complaint_count_max) return;
    va_list arguments;
    va_start(arguments, format);
    std::vsnprintf(complaint[index], sizeof complaint[index], format, arguments);
    va_end(arguments);
  }
  void refuse(Errc code) noexcept {
    const auto index = static_cast<std::size_t>(code);
    ++refused[index < code_count_max ? index : 0];
  }
};

}  // namespace agnocast::test
