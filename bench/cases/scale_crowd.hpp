// SPDX-License-Identifier: Apache-2.0
//
// The processes of the case scale: each has as many endpoints as it is told to have, and measures what it is told to.
// A line on its standard input is a command, a line on its standard output the answer:
//
//   subscribe TOPIC COUNT PLACE          subscriptions with a callback, noting arrivals from that place on
//   advertise TOPIC COUNT                publishers
//   pairs PREFIX FIRST COUNT             a publisher and a subscription on each of PREFIXn, n = FIRST, FIRST+1, …
//   send TOPIC COUNT RECEIVERS NUMBER    by its first publisher there, each when the last one has arrived everywhere
//   join TOPIC COUNT                     a subscription is made and, when it has the last message, destroyed again
//   speak TOPIC COUNT RECEIVERS NUMBER   a publisher is made, publishes, and is destroyed when that has arrived
//
// The answer is "ok" and nanoseconds (of each creation, or pairs of call and arrival), "no" and which limit it has met, or
// "failed" and why, such as a message that has not come. While something is measured nothing is said: arrivals are noted in shared memory.
#pragma once

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdint>

namespace agnocast::bench {

/// Whether a call that sets this errno has met a limit: of memory, descriptors, processes, or of a file system in memory.
constexpr bool is_limit(int os_errno) noexcept {
  return os_errno == EMFILE || os_errno == ENFILE || os_errno == ENOMEM || os_errno == EAGAIN ||
         os_errno == ENOSPC;
}

/// Where receivers note what has come last and when; a memfd that all processes of a scene inherit.
class Arrivals {
 public:
  static constexpr std::size_t place_count = 1024;

  Arrivals();
  /// Of the process that made it.
  explicit Arrivals(int descriptor);
  ~Arrivals();
  Arrivals(const Arrivals&) = delete;
  Arrivals& operator=(const Arrivals&) = delete;

  int descriptor() const noexcept { return descriptor_; }
  /// Any thread, one for each place at a time.
  void note(std::size_t place, std::uint64_t number) noexcept;
  /// When the last of the first `count` places got that number or a later one; 0: not all within ten seconds.
  std::int64_t wait_for_last(std::size_t count, std::uint64_t number) const;

 private:
  struct alignas(64) Place {
    std::atomic<std::int64_t> ns;
    std::atomic<std::uint64_t> number;
  };
  void map();
  int descriptor_;
  Place* places_ = nullptr;
};

}  // namespace agnocast::bench
