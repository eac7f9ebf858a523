// SPDX-License-Identifier: Apache-2.0
//
// Errands: calls that may take as long as a client likes, and so must not be made in the loop.
//
// A close of a descriptor that a client sent, a look at /proc/PID/maps of its process, a change of
// a file that it may write to: each may sleep in the kernel for ever. Threads of this pool make
// such calls; the loop queues them and gets an answer later.
//
//   loop:    run(lane, uid, errand, then) ──▶ queue of this lane and user
//   thread:                                   errand()  ──▶ answers, eventfd
//   loop:    the dispatcher finds the eventfd ───────────▶ then()
//
// Each lane of each user runs one errand at a time, in order: an errand that never ends keeps one
// thread and delays only later errands of the same lane and user. waiting() returns their number;
// callers refuse requests beyond a limit. When all threads are busy, further users wait.
//
// The daemon never waits for a thread, not even at its end: a stuck thread ends with the process.
// So an errand touches only what it owns, and `then` runs in the loop, while the pool exists.
#pragma once

#include <agnocast/result.hpp>
#include <daemon/transport/dispatcher.hpp>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>

namespace agnocast::daemon {

class Errands {
 public:
  enum class Lane : std::uint8_t { closing, receiving, looking, freeing, clearing, scheduling };
  /// A user may block one for each lane; each costs a stack that is hardly touched.
  static constexpr std::size_t thread_count_max = 64;

  /// Makes a pool. Errors: os_failure.
  [[nodiscard]] static Result<std::unique_ptr<Errands>> create(Dispatcher& dispatcher);
  ~Errands();
  Errands(const Errands&) = delete;
  Errands& operator=(const Errands&) = delete;

  /// Runs the errand in another thread, then `then` (if given) in the loop. Neither may throw.
  void run(Lane lane, std::uint32_t uid, std::function<void()> errand,
           std::function<void()> then = {});
  /// The same for errands that may be refused: returns false, and queues nothing, when there is no
  /// thread and none can be made.
  [[nodiscard]] bool try_run(Lane lane, std::uint32_t uid, std::function<void()> errand,
                             std::function<void()> then);
  /// Returns how many errands of this lane and user have not ended.
  std::size_t waiting(Lane lane, std::uint32_t uid) const;

 private:
  struct State;
  Errands(Dispatcher& dispatcher, std::shared_ptr<State> state)
      : dispatcher_(dispatcher), state_(std::move(state)) {}
  void answer();

  Dispatcher& dispatcher_;
  std::shared_ptr<State> state_;
  Dispatcher::Token token_ = 0;
};

}  // namespace agnocast::daemon
