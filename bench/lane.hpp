// SPDX-License-Identifier: Apache-2.0
//
// Lane: the shared memory of the processes of one run. It paces them and stores the times, so
// that no measured message includes a pipe, a file or a system call of the benchmark itself.
//
//   head                 the run, its state, the first error
//   seen[receivers]      progress of each receiver, a cache line each
//   sent[messages]       when the publish call began and when it returned
//   received[receivers × messages]
//   scratch              for floors
//
//   state:  waiting ──conductor: go──▶ running ──sender: all seen──▶ over
//
// The conductor makes it (a memfd), the others attach by the inherited descriptor. All are
// processes of one run, of programs that were built from the same sources: others are refused.
#pragma once

#include <bench/system.hpp>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace agnocast::bench {

/// Returns CLOCK_MONOTONIC in nanoseconds.
std::int64_t now_ns() noexcept;

/// Placement and scheduling of the processes of a run.
enum class Cores : std::uint32_t {
  anywhere,  ///< not pinned, ordinary scheduling
  one,       ///< all on the first of cpus()
  two,       ///< sender on the first, receivers on the second
};

/// Parameters of a run.
struct Plan {
  std::size_t bytes = 1024;
  std::size_t receivers = 1;
  std::size_t messages = 1000;  ///< measured
  std::size_t warm_up = 100;    ///< sent before them, and not measured
  std::int64_t period_ns =
      1'000'000;  ///< at least, from when all have seen a message to the next publish call
  Cores cores = Cores::anywhere;
  bool is_real_time = true;  ///< SCHED_FIFO if pinned
  std::size_t depth = 10;
  std::int64_t lasting_ns = 0;  ///< throughput: how long to send; there `messages` is 1
  /// The receivers' user; 0: the sender's. Only root can set another.
  std::uint32_t receiver_uid = 0;
  std::size_t all_messages() const noexcept { return warm_up + messages; }
};

class Lane {
 public:
  static constexpr std::size_t scratch_bytes = std::size_t{1} << 16;
  static constexpr std::uint64_t nothing = 0;
  enum State : std::uint32_t { waiting, running, over };

  struct alignas(64) Seen {
    std::atomic<std::uint64_t> number;  ///< of the last verified message; they count from 1
    std::int64_t at_ns;                 ///< its time
  };
  struct Sent {
    std::int64_t begin_ns, end_ns;
  };
  struct Head {
    std::uint64_t layout;  ///< Lane::layout of the program that made it
    Plan plan;
    char system[64];
    char topic[128];
    std::atomic<std::uint32_t> state;            ///< a futex
    std::atomic<std::uint32_t> ready;            ///< processes that have opened their end
    std::atomic<std::uint32_t> has_matched;      ///< the sender is matched with all receivers
    std::atomic<std::uint32_t> is_without_fifo;  ///< SCHED_FIFO was refused in a process
    std::atomic<std::uint32_t> has_error;
    std::int64_t sender_cpu_ns;  ///< of all threads of its process, for the measured messages
    char error[512];
  };

  /// Changes with the sizes of what follows; a change of meaning alone needs a new number.
  static const std::uint64_t layout;

  /// Makes a new one. Throws std::runtime_error.
  Lane(const Plan& plan, std::string_view system, std::string_view topic);
  /// Attaches an inherited one.
  explicit Lane(int descriptor);
  ~Lane();
  Lane(const Lane&) = delete;
  Lane& operator=(const Lane&) = delete;

  int descriptor() const noexcept { return descriptor_; }
  Head& head() const noexcept { return *head_; }
  const Plan& plan() const noexcept { return head_->plan; }
  Seen& seen(std::size_t receiver) const noexcept { return seen_[receiver]; }
  /// `number` counts from 1.
  Sent& sent(std::uint64_t number) const noexcept { return sent_[number - 1]; }
  std::int64_t& received_ns(std::size_t receiver, std::uint64_t number) const noexcept {
    return received_[receiver * plan().all_messages() + number - 1];
  }
  void* scratch() const noexcept { return scratch_; }

  bool have_all_seen(std::uint64_t number) const noexcept;
  /// Returns when the last receiver saw a message that all have seen.
  std::int64_t all_seen_ns() const noexcept;
  /// Only the first error is kept.
  void set_error(std::string_view text) noexcept;
  std::string error() const;
  void set_state(State state) noexcept;
  /// Sleeps until the state differs from `state`.
  void wait_while(State state) const noexcept;

 private:
  void map(std::size_t bytes);
  void place(const Plan& plan) noexcept;

  int descriptor_ = -1;
  void* base_ = nullptr;
  std::size_t bytes_ = 0;
  Head* head_ = nullptr;
  Seen* seen_ = nullptr;
  Sent* sent_ = nullptr;
  std::int64_t* received_ = nullptr;
  void* scratch_ = nullptr;
};

// --- payload: its number in front, then pages full of a byte that depends on number and page. It
// is written completely for every system, so that none has its payload in the caches where
// another has not.

void mark(std::byte* payload, std::size_t bytes, std::uint64_t number) noexcept;
std::uint64_t number_of(const std::byte* payload) noexcept;
/// Reads every byte.
bool is_intact(const std::byte* payload, std::size_t bytes, std::uint64_t number) noexcept;

}  // namespace agnocast::bench
