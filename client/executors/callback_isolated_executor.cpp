// SPDX-License-Identifier: Apache-2.0
//
// CallbackIsolatedExecutor: while it spins, each group is in a core of its own, which one thread
// spins; otherwise all groups are in the executor's core, as in other executors.

#include <client/executors/executor_state.hpp>
#include <client/executors/spinning_threads.hpp>

#include <algorithm>
#include <atomic>
#include <list>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

/// A group and, while the executor spins, its core and thread.
struct Isolated {
  explicit Isolated(std::shared_ptr<GroupCallbacks> whose) noexcept : group(std::move(whose)) {}

  std::shared_ptr<GroupCallbacks> group;  // null: it has left, and the thread ends
  std::shared_ptr<ExecutorCore> core;
  std::thread thread;
  std::atomic<bool> has_ended{false};  // the thread, but for its last instructions
};

class IsolatedGroups final : public GroupExecutor {
 public:
  explicit IsolatedGroups(ExecutorCore& idle) noexcept : idle_(idle) {}

  Result<void> adopt(const std::shared_ptr<GroupCallbacks>& group) override {
    const std::lock_guard lock(mutex_);
    std::list<Isolated> added;
    added.emplace_back(group);
    Result<void> begun = first_ != nullptr ? isolate(added.back()) : idle_.adopt(group);
    if (begun) isolated_.splice(isolated_.end(), added);
    return begun;
  }
  Result<void> listen(const GroupCallbacks& group, std::shared_ptr<WaitSet> wait_set) override {
    const std::lock_guard lock(mutex_);
    return core_of(*find(group)).listen(group, std::move(wait_set));
  }
  void drop(GroupCallbacks& group) noexcept override {
    const std::lock_guard lock(mutex_);
    const auto found = find(group);
    core_of(*found).drop(group);
    if (found->core == nullptr) return (void)isolated_.erase(found);
    found->group = nullptr;
    found->core->cancel();  // tend() joins the thread, which may be this one
  }

  /// Gives each group a thread. Exceptions of callbacks go to `first`. Throws Error: os_failure.
  void begin(FirstException& first) {
    const std::lock_guard lock(mutex_);
    first_ = &first;
    for (Isolated& isolated : isolated_) {
      idle_.drop(*isolated.group);
      if (Result<void> begun = isolate(isolated); !begun) throw Error(begun.error());
    }
  }
  /// Joins the threads that have ended; one that a callback has ended (pthread_exit) gets a
  /// successor. Throws Error: os_failure.
  void tend() {
    std::list<std::thread> ended;  // joined without the lock, which destructors of theirs may take
    struct Joining {
      std::list<std::thread>& threads;
      ~Joining() {
        for (std::thread& thread : threads) thread.join();
      }
    };
    const Joining joining{ended};
    const std::lock_guard lock(mutex_);
    for (auto next = isolated_.begin(); next != isolated_.end() && !*first_;) {
      const auto isolated = next++;
      if (!isolated->has_ended.load(std::memory_order_acquire)) continue;
      ended.emplace_back().swap(isolated->thread);
      if (isolated->group == nullptr) {
        isolated_.erase(isolated);
      } else if (Result<void> begun = start(*isolated); !begun) {
        throw Error(begun.error());
      }
    }
  }
  /// Ends all threads, and gives the groups back. Throws Error: os_failure.
  void end() {
    if (is_forked_child()) return;  // the locks and threads belong to the parent
    {
      const std::lock_guard lock(mutex_);
      for (Isolated& isolated : isolated_) {
        if (isolated.core != nullptr) isolated.core->cancel();
      }
    }
    // A thread that still runs a callback may add and remove groups meanwhile.
    for (;;) {
      std::thread thread;
      {
        const std::lock_guard lock(mutex_);
        const auto running =
            std::find_if(isolated_.begin(), isolated_.end(),
                         [](const Isolated& isolated) { return isolated.thread.joinable(); });
        if (running == isolated_.end()) return give_back();
        running->core->cancel();
        thread.swap(running->thread);
      }
      thread.join();
    }
  }

 private:
  std::list<Isolated>::iterator find(const GroupCallbacks& group) noexcept {
    return std::find_if(isolated_.begin(), isolated_.end(),
                        [&](const Isolated& isolated) { return isolated.group.get() == &group; });
  }
  ExecutorCore& core_of(const Isolated& isolated) noexcept {
    return isolated.core != nullptr ? *isolated.core : idle_;
  }

  /// After a failure the group is nowhere.
  Result<void> isolate(Isolated& isolated) {
    auto made = ExecutorCore::make();
    if (!made) return tl::unexpected<Failure>(made.error());
    isolated.core = std::move(*made);
    Result<void> begun = isolated.core->adopt(isolated.group);
    if (begun) begun = start(isolated);
    if (begun) return begun;
    isolated.core->drop(*isolated.group);
    isolated.core = nullptr;
    return begun;
  }
  Result<void> start(Isolated& isolated) {
    isolated.has_ended.store(false, std::memory_order_relaxed);
    auto started = start_spinning_thread([&isolated, first = first_, this] {
      struct Ending {
        Isolated& isolated;
        ExecutorCore& idle;
        ~Ending() {
          if (is_forked_child()) return;
          isolated.has_ended.store(true, std::memory_order_release);
          idle.wake();
        }
      };
      const Ending ending{isolated, idle_};
      ExecutorCore& core = *isolated.core;
      first->guard([&] {
        while (!core.is_cancelled()) {
          if (!core.run_next()) core.wait(std::nullopt);
        }
      });
    });
    if (!started) return tl::unexpected<Failure>(started.error());
    isolated.thread = std::move(*started);
    return {};
  }

  /// Under the mutex, without threads.
  void give_back() {
    first_ = nullptr;
    std::optional<Failure> failed;
    std::erase_if(isolated_, [](const Isolated& isolated) { return isolated.group == nullptr; });
    for (Isolated& isolated : isolated_) {
      core_of(isolated).drop(*isolated.group);
      isolated.core = nullptr;
      if (Result<void> back = idle_.adopt(isolated.group); !back) failed = back.error();
    }
    if (failed) throw Error(*failed);
  }

  ExecutorCore& idle_;
  std::mutex mutex_;  // taken before those of cores
  std::list<Isolated> isolated_;
  FirstException* first_ = nullptr;  // while it spins
};

struct IsolatedState final : Executor::State {
  IsolatedState() : State(make_core(), std::chrono::nanoseconds(0)) {}
  GroupExecutor& groups() noexcept override { return isolating; }
  IsolatedGroups isolating{*core};
};

}  // namespace

CallbackIsolatedExecutor::CallbackIsolatedExecutor()
    : Executor(std::make_unique<IsolatedState>()) {}
CallbackIsolatedExecutor::~CallbackIsolatedExecutor() = default;

void CallbackIsolatedExecutor::spin() {
  const Spinning spinning(state());
  ExecutorCore& core = *state().core;
  IsolatedGroups& groups = static_cast<IsolatedState&>(state()).isolating;
  FirstException first;
  // Also if this thread is cancelled in its sleep: the others refer to `first`.
  struct Ending {
    IsolatedGroups& groups;
    FirstException& first;
    ~Ending() {
      first.guard([this] { groups.end(); });
    }
  };
  {
    const Ending ending{groups, first};
    first.guard([&] {
      groups.begin(first);
      while (!core.is_cancelled() && !first) {
        core.wait(std::nullopt);
        groups.tend();
      }
    });
  }
  if (!first) core.take_cancel();
  first.rethrow();
}

}  // namespace agnocast
