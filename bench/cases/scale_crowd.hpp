// SPDX-License-Identifier: Apache-2.0
//
// The processes of the case scale: each creates endpoints and measures as commanded. A line on
// its standard input is a command, a line on its standard output the answer:
//
//   subscribe TOPIC COUNT PLACE          creates subscriptions with a callback that records
//                                        arrivals, from index PLACE on
//   advertise TOPIC COUNT                creates publishers
//   pairs PREFIX FIRST COUNT             creates a publisher and a subscription on each of
//                                        PREFIXn, n = FIRST, FIRST+1, …
//   send TOPIC COUNT RECEIVERS NUMBER    publishes with its first publisher there, each after the
//                                        last one has arrived everywhere
//   join TOPIC COUNT                     creates a subscription, and destroys it when it has the
//                                        last message
//   speak TOPIC COUNT RECEIVERS NUMBER   creates a publisher, publishes, and destroys it after
//                                        the arrival
//
// The answer is "ok" and nanoseconds (of each creation, or pairs of call and arrival), "no" and
// the limit it met, or "failed" and the reason, such as a missing message. During a measurement
// it prints nothing: receivers record arrivals in shared memory.
#pragma once

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdint>

namespace agnocast::bench {

/// Returns whether this errno of a call means a limit: of memory, descriptors, processes, or of a
/// file system in memory.
constexpr bool is_limit(int os_errno) noexcept {
  return os_errno == EMFILE || os_errno == ENFILE || os_errno == ENOMEM || os_errno == EAGAIN ||
         os_errno == ENOSPC;
}

/// The last message of each receiver with its time; a memfd that all processes of a scene
/// inherit.
class Arrivals {
 public:
  static constexpr std::size_t place_count = 1024;

  Arrivals();
  /// Attaches the memfd of the process that made it.
  explicit Arrivals(int descriptor);
  ~Arrivals();
  Arrivals(const Arrivals&) = delete;
  Arrivals& operator=(const Arrivals&) = delete;

  int descriptor() const noexcept { return descriptor_; }
  /// Any thread, one for each place at a time.
  void note(std::size_t place, std::uint64_t number) noexcept;
  /// Returns when the last of the first `count` receivers got that number or a later one; 0: not
  /// all within ten seconds.
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
