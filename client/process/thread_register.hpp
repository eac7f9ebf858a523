// SPDX-License-Identifier: Apache-2.0
//
// ThreadRegister: which executors of this process have which callback groups, and which threads
// run them. The control thread of a session tells the daemon (session/thread_report.hpp), which
// lists the threads and applies the rules of its configuration to them.
//
// A thread belongs to an executor from its first callback there until it ends or the executor is
// destroyed: user threads come and go with spin_some(), and keep their place meanwhile.
#pragma once

#include <agnocast/callback_group.hpp>
#include <client/process/control_wake.hpp>

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace agnocast {

class ThreadRegister {
 public:
  /// A callback group and its executor, by their numbers in this process.
  struct Group {
    std::uint64_t executor, group;
    CallbackGroupType type;
    std::string node, name;
  };
  struct Thread {
    std::uint64_t executor;
    std::uint32_t thread;  // gettid(2)
    std::uint64_t number;  // tells a thread from an earlier one with this id
    friend auto operator<=>(const Thread&, const Thread&) = default;
  };

  static ThreadRegister& instance() noexcept;
  /// Returns a number that no other executor or group of this process has.
  static std::uint64_t next_number() noexcept;

  // --- any thread; without memory, the daemon does not hear of the group or thread

  void add(const Group& group) noexcept;
  void remove_group(std::uint64_t executor, std::uint64_t group) noexcept;
  /// The calling thread runs callbacks of this executor. Costs a comparison if it is known.
  static void note(std::uint64_t executor) noexcept {
    if (noted_ != executor) instance().add_this_thread(executor);
  }
  void remove_executor(std::uint64_t executor) noexcept;

  // --- a control thread

  /// Wakes this control thread, and no longer the one of an earlier session, after each change.
  void set_wake(std::shared_ptr<const ControlWake> wake) noexcept;
  /// Returns a number that grows with each change.
  std::uint64_t version() const noexcept { return version_.load(std::memory_order_acquire); }
  /// Throws std::bad_alloc.
  void copy(std::vector<Group>& groups, std::vector<Thread>& threads) const;

 private:
  struct LeavingThread;

  void add_this_thread(std::uint64_t executor) noexcept;
  void remove_thread(std::uint32_t thread) noexcept;
  void changed() noexcept;  // under the mutex

  static inline thread_local constinit std::uint64_t noted_ = 0;

  mutable std::mutex mutex_;  // taken after those of executors and groups
  std::vector<Group> groups_;
  std::vector<Thread> threads_;
  std::shared_ptr<const ControlWake> wake_;
  std::atomic<std::uint64_t> version_{0};
};

}  // namespace agnocast
