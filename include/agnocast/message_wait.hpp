// SPDX-License-Identifier: Apache-2.0
//
// MessageWait: the sleep of a loop that takes messages itself, instead of an executor that calls
// callbacks:
//
//   agnocast::MessageWait wait;
//   while (wait.wait_until(end, [&] { return points->has_unread() || is_stopped; })) {
//     while (auto cloud = points->take()) …
//   }
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/result.hpp>

#include <chrono>
#include <memory>

namespace agnocast {

/// Sleeps while none of this process's subscriptions without a callback gets a message, and no
/// count of an endpoint without callbacks changes (events.hpp). One thread waits on it at a
/// time; any number of them may exist, each with three descriptors. A message that comes to such a
/// subscription ends the sleep of all of them for the moment of a look.
class AGNOCAST_PUBLIC MessageWait {
 public:
  using Clock = std::chrono::steady_clock;

  /// Errors: as create_subscription has them for connecting; os_failure.
  [[nodiscard]] static Result<std::unique_ptr<MessageWait>> try_create() noexcept;
  /// The same; throws Error.
  MessageWait();
  ~MessageWait();
  MessageWait(const MessageWait&) = delete;
  MessageWait& operator=(const MessageWait&) = delete;

  /// Sleeps until `is_ready()` is true, or until `end`; returns what it returned last. Calls it
  /// before the first sleep, and after each message, change of a count, wake() and second. It must
  /// not throw. In a forked child it is called once, and nothing sleeps. No system call if it is
  /// true at once.
  template <class Ready>
  bool wait_until(Clock::time_point end, Ready&& is_ready) noexcept {
    const auto look = [&]() noexcept { return static_cast<bool>(is_ready()); };
    return wait([](const void* at) noexcept { return (*static_cast<decltype(&look)>(at))(); },
                &look, end);
  }
  /// The same without an end.
  template <class Ready>
  bool wait(Ready&& is_ready) noexcept {
    return wait_until(Clock::time_point::max(), is_ready);
  }

  /// Makes the thread that waits call is_ready() again: change what that looks at, then call this.
  /// If none waits it does nothing. A system call only while a thread sleeps. Any thread, any
  /// signal handler.
  void wake() noexcept;

 private:
  struct State;
  explicit MessageWait(std::unique_ptr<State> state) noexcept;
  bool wait(bool (*is_ready)(const void*) noexcept, const void* context,
            Clock::time_point end) noexcept;

  std::unique_ptr<State> state_;
};

}  // namespace agnocast
