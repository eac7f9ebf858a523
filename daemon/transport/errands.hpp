// SPDX-License-Identifier: Apache-2.0
//
// Errands: calls that may take as long as a client likes, and so must not be made in the loop.
//
// A close of a descriptor that a client sent, a look at /proc/PID/maps of its process, a change of
// a file that it may write to: each may sleep in the kernel for ever. Threads of this pool make
// such calls; the loop hands them in and gets an answer later.
//
//   loop:    run(lane, uid, errand, then) ──▶ queue of this lane and user
//   thread:                                   errand()  ──▶ answers, eventfd
//   loop:    the dispatcher finds the eventfd ───────────▶ then()
//
// Of one lane of one user, one errand at a time is under way, in order: an errand that never ends
// keeps one thread and the later errands of that user waiting, and nobody else's. waiting() is what
// the user has waiting; callers refuse what would make it too much. A pool that has all its threads
// lets further users wait.
//
// Nobody waits for a thread, not even at the end: a thread that is stuck ends with the process. So
// an errand touches only what it owns, and `then` runs in the loop, never after the pool is gone.
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
  enum class Lane : std::uint8_t { closing, receiving, looking, freeing, clearing };
  /// A user may have one stuck for each lane; each is a stack that is hardly touched.
  static constexpr std::size_t thread_count_max = 64;

  /// Errors: os_failure.
  [[nodiscard]] static Result<std::unique_ptr<Errands>> create(Dispatcher& dispatcher);
  ~Errands();
  Errands(const Errands&) = delete;
  Errands& operator=(const Errands&) = delete;

  /// Makes the call in another thread, then `then` (if there is one) in the loop. Neither may
  /// throw.
  void run(Lane lane, std::uint32_t uid, std::function<void()> errand,
           std::function<void()> then = {});
  /// The same for what can be refused: false, and nothing was handed in, when there is no thread
  /// and none can be had.
  [[nodiscard]] bool try_run(Lane lane, std::uint32_t uid, std::function<void()> errand,
                             std::function<void()> then);
  /// Errands of this lane and user that have not ended.
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
