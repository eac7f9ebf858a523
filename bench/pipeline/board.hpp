// SPDX-License-Identifier: Apache-2.0
//
// Board: the shared memory of a pipeline's processes. The conductor makes it; the others attach
// by an inherited descriptor. It paces the frames, one at a time, and stores their times
// (CLOCK_MONOTONIC).
//
//   conductor    writes a frame's plan ──go[lidar]──▶ the LiDARs sleep until `released_ns`, work and send
//   concatenate  has all three, works, writes what came out ──done──▶ conductor
//
// The members below are grouped by their writer; the semaphores order everything else.
#pragma once

#include <bench/pipeline/vehicle.hpp>

#include <semaphore.h>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace agnocast::bench::pipeline {

struct alignas(64) Frame {
  // The conductor.
  std::uint32_t edge = 0;        ///< index in edges()
  std::uint32_t input = 0;       ///< index of the cached scan
  std::int64_t released_ns = 0;  ///< the sensors' stamp
  // The LiDARs, each its own.
  struct Chain {
    std::int64_t cpu_ns = 0;   ///< of its thread
    std::int64_t done_ns = 0;  ///< just before sending
    std::uint64_t bytes = 0;   ///< of points sent
  };
  std::array<Chain, lidar_count> chains;
  // Concatenate.
  std::array<std::int64_t, lidar_count> received_ns{};
  std::int64_t cpu_ns = 0;
  std::int64_t done_ns = 0;
  std::uint64_t points = 0, checksum = 0;
};

class Board {
 public:
  struct alignas(64) Head {
    sem_t go[lidar_count];
    sem_t done;
    sem_t over;                          ///< for concatenate
    std::atomic<std::uint32_t> is_over;  ///< for the LiDARs, after their go
    std::atomic<std::uint32_t> ready;    ///< processes that have found their peers
    std::atomic<std::uint32_t> current;  ///< index of the present frame
    std::atomic<std::uint32_t> has_error;
    std::size_t frames;
    char error[512];
  };

  explicit Board(std::size_t frames);
  struct Inherited {
    int descriptor;
  };
  explicit Board(Inherited from);
  ~Board();
  Board(const Board&) = delete;
  Board& operator=(const Board&) = delete;

  int descriptor() const noexcept { return descriptor_; }
  Head& head() const noexcept { return *static_cast<Head*>(base_); }
  std::span<Frame> frames() const noexcept { return {frames_begin(), head().frames}; }
  /// Keeps only the first error. Wakes the conductor.
  void set_error(std::string_view text) noexcept;
  std::string error() const;

 private:
  Frame* frames_begin() const noexcept;
  void map(std::size_t bytes);

  int descriptor_ = -1;
  void* base_ = nullptr;
  std::size_t bytes_ = 0;
};

/// Waits for a post; signals do not matter.
void wait(sem_t& semaphore) noexcept;
/// Returns false when the time is up.
bool wait(sem_t& semaphore, std::int64_t at_most_ns) noexcept;

}  // namespace agnocast::bench::pipeline
