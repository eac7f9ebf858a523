// SPDX-License-Identifier: Apache-2.0
//
// CallbackGroupWaitable: lets an executor that is not of this library run the callbacks of one
// callback group, in any number of threads. For one loop in one thread, see Executor::fd().
#pragma once

#include <agnocast/callback_group.hpp>
#include <agnocast/export.hpp>

#include <cstddef>
#include <memory>

namespace agnocast {

/// The executor of one group. Any thread may call any function at any time, but not in a forked
/// child. It waits like this:
///
///   if (!waitable.prepare()) wait until waitable.fd() is readable;   // then begin again
///   waitable.run_one();
class AGNOCAST_PUBLIC CallbackGroupWaitable {
 public:
  /// Takes the group over. Throws Error: invalid_argument (it is in an executor already),
  /// shut_down (in a forked child), os_failure.
  explicit CallbackGroupWaitable(CallbackGroup& group);
  /// Nobody runs the group then. A running callback ends where it is.
  ~CallbackGroupWaitable();
  CallbackGroupWaitable(const CallbackGroupWaitable&) = delete;
  CallbackGroupWaitable& operator=(const CallbackGroupWaitable&) = delete;

  /// Readable when prepare() should be called: something has come since it returned false, or a
  /// timer is due, or a second is over (see Executor::fd()). Never read from it. Constant.
  int fd() const noexcept;
  /// Returns whether a callback could begin now; if not, makes fd() readable when one can. A busy
  /// group has nothing: call it again when its callback has ended. One or two system calls.
  bool prepare() noexcept;
  /// Returns how many callbacks could begin now, at most one of each subscription, timer, … An
  /// exclusive group begins them one after another. No system call.
  std::size_t ready_count() const noexcept;
  /// Runs one callback, of the subscription, timer, … that ran longest ago; returns false if there
  /// was none, because another thread was faster or the group is busy. Throws what the callback
  /// throws, and Error (shut_down) if it has returned in a forked child.
  bool run_one();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace agnocast
