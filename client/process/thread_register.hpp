// SPDX-License-Identifier: Apache-2.0
//
// ThreadRegister: which executors of this process have which callback groups, and which threads
// run them. The control thread of a session tells the daemon (upkeep/thread_report.hpp), which
// lists the threads and applies the rules of its configuration to them.
//
// A thread belongs to an executor since it first looked for a callback there, until it ends or the
// executor is destroyed: user threads come and go with spin_some(), and keep their place meanwhile.
#pragma once

#include <agnocast/callback_group.hpp>
#include <client/process/control_wake.hpp>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <string_view>
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

  void add(std::uint64_t executor, std::uint64_t group, CallbackGroupType type,
           std::string_view node, std::string_view name) noexcept;
  void remove_group(std::uint64_t executor, std::uint64_t group) noexcept;
  /// The calling thread runs callbacks of this executor. Costs a comparison if that is known, which
  /// may be forgotten in a thread that spins many executors in turn.
  static void note(std::uint64_t executor) noexcept {
    if (noted_[executor % noted_count] != executor) instance().add_this_thread(executor);
  }
  void remove_executor(std::uint64_t executor) noexcept;

  // --- a control thread

  /// Wakes this control thread, and no longer the one of an earlier session, after each change.
  void set_wake(std::shared_ptr<const ControlWake> wake) noexcept;
  /// Returns a number that grows with each change.
  std::uint64_t version() const noexcept { return version_.load(std::memory_order_acquire); }
  /// Throws std::bad_alloc. Brief under the mutex, which threads with real-time policies take.
  void copy(std::vector<std::shared_ptr<const Group>>& groups, std::vector<Thread>& threads) const;

 private:
  struct LeavingThread;

  void add_this_thread(std::uint64_t executor) noexcept;
  void remove_thread(std::uint32_t thread) noexcept;
  void changed() noexcept;  // under the mutex

  struct ByThread {  // number is not part of the identity
    bool operator()(const Thread& a, const Thread& b) const noexcept {
      return a.thread != b.thread ? a.thread < b.thread : a.executor < b.executor;
    }
  };

  // rclcpp's threads spin an executor of ours for each callback group.
  static constexpr std::size_t noted_count = 64;
  static inline thread_local constinit std::array<std::uint64_t, noted_count> noted_{};

  mutable std::mutex mutex_;  // taken after those of executors and groups
  std::vector<std::shared_ptr<const Group>> groups_;
  std::set<Thread, ByThread> threads_;
  std::shared_ptr<const ControlWake> wake_;
  std::atomic<std::uint64_t> version_{0};
};

}  // namespace agnocast
