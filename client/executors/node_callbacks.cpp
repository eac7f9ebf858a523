// SPDX-License-Identifier: Apache-2.0

#include <client/executors/callback_waits.hpp>
#include <client/executors/node_callbacks.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/library_thread.hpp>
#include <client/process/user_code.hpp>

#include <algorithm>
#include <utility>

namespace agnocast {

void NodeCallbacks::add(std::shared_ptr<CallbackSource> source) {
  {
    const std::lock_guard lock(mutex_);
    sources_.push_back(std::move(source));
    count_change();
  }
  wait_set_->wake();
}

void NodeCallbacks::remove(CallbackSource& source, std::shared_ptr<const void> runner) noexcept {
  if (is_forked_child()) return;         // the lock may belong to the parent
  std::shared_ptr<CallbackSource> last;  // destroyed after unlocking: it may own the callback
  std::unique_lock lock(mutex_);
  const auto found = std::find_if(sources_.begin(), sources_.end(), [&](const auto& candidate) {
    return candidate.get() == &source;
  });
  if (found == sources_.end()) return;
  last = std::move(*found);
  sources_.erase(found);
  count_change();
  source.removed_ = true;
  if (running_thread_ == std::this_thread::get_id() || !wait_for_end(source, lock))
    until_end_.swap(runner);
  lock.unlock();
}

/// Returns false if it still runs, because it waits for this thread, or because exit() bounds the
/// wait.
bool NodeCallbacks::wait_for_end(const CallbackSource& source,
                                 std::unique_lock<std::mutex>& lock) noexcept {
  if (running_ != &source) return true;
  CallbackWaits& waits = CallbackWaits::instance();
  if (!waits.begin(running_thread_, this)) return false;
  ++waiters_;
  bool has_ended = false;
  do {
    has_ended =
        callback_ended_.wait_for(lock, ExitPatience::look, [&] { return running_ != &source; });
  } while (!has_ended && !ExitPatience::is_over());
  --waiters_;
  waits.end();
  return has_ended;
}

void NodeCallbacks::hand_to(ExecutorId executor) noexcept {
  {
    const std::lock_guard lock(mutex_);
    if (armed_) wait_set_->disarm();
    armed_ = false;
    executor_ = executor;
    count_change();
    executor_changed_.notify_all();
  }
  wait_set_->wake();  // the sleeping thread must check whether it is still the executor
}

bool NodeCallbacks::await(ExecutorId executor) noexcept {
  std::unique_lock lock(mutex_);
  const auto has_changed = [&] { return stopped_ || executor_ == executor; };
  if (has_changed()) return !stopped_;
  shed_signals();
  executor_changed_.wait(lock, has_changed);
  return !stopped_;
}

void NodeCallbacks::stop() noexcept {
  {
    const std::lock_guard lock(mutex_);
    if (armed_) wait_set_->disarm();  // the next user of the wait set begins awake
    armed_ = false;
    stopped_ = true;
    executor_changed_.notify_all();
  }
  wait_set_->wake();
}

std::uint64_t NodeCallbacks::list(ExecutorId executor,
                                  std::vector<std::weak_ptr<CallbackSource>>& sources) const {
  const std::lock_guard lock(mutex_);
  if (executor_ == executor) sources.insert(sources.end(), sources_.begin(), sources_.end());
  return list_changes();
}

bool NodeCallbacks::has_work(ExecutorId executor) const noexcept {
  const std::lock_guard lock(mutex_);
  return has_work_here(executor);
}

bool NodeCallbacks::has_work_here(ExecutorId executor) const noexcept {
  return executor_ == executor && running_ == nullptr && !stopped_ &&
         std::any_of(sources_.begin(), sources_.end(),
                     [](const auto& source) { return source->has_work(); });
}

struct NodeCallbacks::Ending {
  NodeCallbacks& node;
  ExecutorId executor;
  ~Ending() {
    if (is_forked_child()) return;           // the lock may belong to the parent
    std::shared_ptr<const void> to_release;  // after unlocking: its destructor takes locks
    const std::lock_guard lock(node.mutex_);
    to_release.swap(node.until_end_);
    node.running_ = nullptr;
    node.running_thread_ = {};
    if (node.waiters_ != 0) CallbackWaits::instance().end_of(&node);
    node.callback_ended_.notify_all();
    if (node.executor_ != executor)
      node.wait_set_->wake();  // the new executor has seen nothing meanwhile
  }
};

bool NodeCallbacks::run(ExecutorId executor, CallbackSource& source) {
  {
    const std::lock_guard lock(mutex_);
    if (executor_ != executor || running_ != nullptr || source.removed_ || stopped_) return false;
    running_ = &source;
    running_thread_ = std::this_thread::get_id();
  }
  const Ending ending{*this, executor};
  return source.run_one();
}

bool NodeCallbacks::arm_or_find_work(ExecutorId executor) noexcept {
  const std::lock_guard lock(mutex_);
  if (executor_ != executor || stopped_) return false;
  wait_set_->arm();
  armed_ = !has_work_here(executor);
  if (!armed_) wait_set_->disarm();
  return !armed_;
}

void NodeCallbacks::disarm(ExecutorId executor) noexcept {
  const std::lock_guard lock(mutex_);
  if (executor_ != executor || !armed_) return;
  wait_set_->disarm();
  armed_ = false;
}

void NodeCallbacks::drain(ExecutorId executor) noexcept {
  wait_set_->drain();
  // The previous executor may have drained a ring that was for the new one.
  const std::lock_guard lock(mutex_);
  if (executor_ != executor) wait_set_->wake();
}

}  // namespace agnocast
