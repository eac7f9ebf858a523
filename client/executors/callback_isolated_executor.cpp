// SPDX-License-Identifier: Apache-2.0
//
// CallbackIsolatedExecutor: while it spins, each group is in a core of its own, which one thread
// spins; otherwise all groups are in the executor's core, as in other executors.

#include <client/executors/executor_state.hpp>
#include <client/executors/spinning_threads.hpp>

#include <algorithm>
#include <list>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

namespace agnocast {
namespace {

/// A group and, while the executor spins, its core and thread.
struct Isolated {
  std::shared_ptr<GroupCallbacks> group;  // null: it has left
  std::shared_ptr<ExecutorCore> core;
  std::thread thread;
};

class IsolatedGroups final : public GroupExecutor {
 public:
  explicit IsolatedGroups(ExecutorCore& idle) noexcept : idle_(idle) {}

  Result<void> adopt(const std::shared_ptr<GroupCallbacks>& group) override {
    const std::lock_guard lock(mutex_);
    Isolated& added = isolated_.emplace_back();
    added.group = group;
    Result<void> begun = first_ != nullptr ? isolate(added) : idle_.adopt(group);
    if (!begun) isolated_.pop_back();
    return begun;
  }
  Result<void> listen(const GroupCallbacks& group, std::shared_ptr<WaitSet> wait_set) override {
    const std::lock_guard lock(mutex_);
    const auto found = find(group);
    return core_of(*found).listen(group, std::move(wait_set));
  }
  void drop(GroupCallbacks& group) noexcept override {
    const std::lock_guard lock(mutex_);
    const auto found = find(group);
    core_of(*found).drop(group);
    found->group = nullptr;
    if (found->core == nullptr) {
      isolated_.erase(found);
    } else {
      found->core->cancel();  // spin() joins the thread, which may be this one
      idle_.wake();
    }
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
  /// Joins the threads whose groups have left, or all.
  void join(bool all) {
    std::list<Isolated> ended;
    {
      const std::lock_guard lock(mutex_);
      for (auto next = isolated_.begin(); next != isolated_.end();) {
        const auto isolated = next++;
        if (all && isolated->core != nullptr) isolated->core->cancel();
        if (isolated->group == nullptr) ended.splice(ended.end(), isolated_, isolated);
      }
    }
    for (Isolated& isolated : ended) isolated.thread.join();
  }
  /// Ends all threads, and gives the groups back. Throws Error: os_failure.
  void end() {
    join(true);
    std::optional<Failure> failed;
    // A thread that still runs a callback may add and remove groups meanwhile.
    for (;;) {
      std::thread thread;
      {
        const std::lock_guard lock(mutex_);
        const auto running =
            std::find_if(isolated_.begin(), isolated_.end(),
                         [](const Isolated& isolated) { return isolated.thread.joinable(); });
        if (running == isolated_.end()) {
          first_ = nullptr;
          failed = give_back();
          break;
        }
        running->core->cancel();
        thread.swap(running->thread);
      }
      thread.join();
    }
    if (failed) throw Error(*failed);
  }

 private:
  std::list<Isolated>::iterator find(const GroupCallbacks& group) noexcept {
    return std::find_if(isolated_.begin(), isolated_.end(),
                        [&](const Isolated& isolated) { return isolated.group.get() == &group; });
  }
  ExecutorCore& core_of(const Isolated& isolated) noexcept {
    return isolated.core != nullptr ? *isolated.core : idle_;
  }

  Result<void> isolate(Isolated& isolated) {
    auto made = ExecutorCore::make();
    if (!made) return tl::unexpected<Failure>(made.error());
    const std::shared_ptr<ExecutorCore> core = std::move(*made);
    if (Result<void> adopted = core->adopt(isolated.group); !adopted) return adopted;
    try {
      isolated.thread = std::thread([core, first = first_, &idle = idle_] {
        first->guard([&] {
          while (!core->is_cancelled()) {
            if (!core->run_next()) core->wait(std::nullopt);
          }
        });
        if (*first) idle.wake();  // spin() ends
      });
    } catch (const std::system_error& refused) {
      core->drop(*isolated.group);
      return fail(Errc::os_failure, "starting a thread of an executor", refused.code().value());
    }
    ::pthread_setname_np(isolated.thread.native_handle(), "agnocast-exec");
    isolated.core = core;
    return {};
  }

  std::optional<Failure> give_back() {
    std::optional<Failure> failed;
    for (auto next = isolated_.begin(); next != isolated_.end();) {
      const auto isolated = next++;
      if (isolated->group == nullptr) {
        isolated_.erase(isolated);
        continue;
      }
      core_of(*isolated).drop(*isolated->group);
      isolated->core = nullptr;
      if (Result<void> back = idle_.adopt(isolated->group); !back) failed = back.error();
    }
    return failed;
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
    first.guard([&] { groups.begin(first); });
    while (!core.is_cancelled() && !first) {
      core.wait(std::nullopt);
      groups.join(false);
    }
  }
  core.take_cancel();
  first.rethrow();
}

}  // namespace agnocast
