// SPDX-License-Identifier: Apache-2.0

#include <client/executors/group_callbacks.hpp>

#include <client/executors/callback_waits.hpp>
#include <client/executors/executor_core.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/user_code.hpp>

#include <algorithm>
#include <utility>

namespace agnocast {

void GroupCallbacks::add(std::shared_ptr<CallbackSource> source) {
  const std::lock_guard lock(mutex_);
  sources_.push_back(std::move(source));
  if (executor_ != nullptr) executor_->wake();
}

void GroupCallbacks::remove(CallbackSource& source,
                            const std::shared_ptr<const void>& group) noexcept {
  if (is_forked_child()) return;         // the lock may belong to the parent
  std::shared_ptr<CallbackSource> last;  // destroyed after unlocking: it may own the callback
  std::unique_lock lock(mutex_);
  const auto found = std::find_if(sources_.begin(), sources_.end(), [&](const auto& candidate) {
    return candidate.get() == &source;
  });
  if (found == sources_.end()) return;
  last = std::move(*found);
  sources_.erase(found);
  while (wait_for_end(source, lock)) {
  }
  for (Running& running : running_) {
    if (running.source == &source || running.thread == std::this_thread::get_id())
      running.until_end = group;
  }
  lock.unlock();
}

/// Waits for one callback of the source. Returns false if there is none to wait for: no other
/// thread runs one that does not wait for this thread, or exit() bounds the wait.
bool GroupCallbacks::wait_for_end(const CallbackSource& source,
                                  std::unique_lock<std::mutex>& lock) noexcept {
  CallbackWaits& waits = CallbackWaits::instance();
  const auto running = std::find_if(running_.begin(), running_.end(), [&](const Running& entry) {
    return entry.source == &source && entry.thread != std::this_thread::get_id() &&
           waits.begin(entry.thread, this);
  });
  if (running == running_.end()) return false;
  const std::thread::id other = running->thread;
  const auto has_ended = [&] {
    return std::none_of(running_.begin(), running_.end(), [&](const Running& entry) {
      return entry.source == &source && entry.thread == other;
    });
  };
  ++waiters_;
  bool ended = false;
  do {
    ended = callback_ended_->wait_for(lock, ExitPatience::look, has_ended);
  } while (!ended && !ExitPatience::is_over());
  --waiters_;
  waits.end();
  return ended;
}

void GroupCallbacks::wake() noexcept {
  if (is_forked_child()) return;
  const std::lock_guard lock(mutex_);
  if (executor_ != nullptr) executor_->wake();
}

void GroupCallbacks::hand_to(ExecutorCore* executor) noexcept {
  const std::lock_guard lock(mutex_);
  executor_ = executor;
  if (executor_ != nullptr) executor_->wake();
}

std::shared_ptr<CallbackSource> GroupCallbacks::begin(const ExecutorCore& executor,
                                                      std::uint64_t cycle, bool is_alone) {
  const std::lock_guard lock(mutex_);
  if (executor_ != &executor) return {};
  if (!is_free()) return {};
  const bool by_taking = is_alone && sources_.size() == 1;
  for (const auto& source : sources_) {
    if (source->cycle_ == cycle || !is_free(*source) || (!by_taking && !source->has_work()))
      continue;
    return begin(source, cycle);
  }
  return {};
}

std::shared_ptr<CallbackSource> GroupCallbacks::begin_oldest(const ExecutorCore& executor,
                                                             std::uint64_t cycle) {
  const std::lock_guard lock(mutex_);
  if (executor_ != &executor || !is_free()) return {};
  const std::shared_ptr<CallbackSource>* oldest = nullptr;
  for (const auto& source : sources_) {
    const bool is_older = oldest == nullptr || source->cycle_ < (*oldest)->cycle_;
    if (is_older && is_free(*source) && source->has_work()) oldest = &source;
  }
  return oldest == nullptr ? nullptr : begin(*oldest, cycle);
}

std::shared_ptr<CallbackSource> GroupCallbacks::begin(const std::shared_ptr<CallbackSource>& source,
                                                      std::uint64_t cycle) {
  running_.push_back({source.get(), std::this_thread::get_id(), {}});
  source->cycle_ = cycle;
  return source;
}

void GroupCallbacks::end(const ExecutorCore& executor, const CallbackSource* source) noexcept {
  if (is_forked_child()) return;           // the lock may belong to the parent
  std::shared_ptr<const void> to_release;  // after unlocking: its destructor takes locks
  const std::lock_guard lock(mutex_);
  const auto ended = std::find_if(running_.begin(), running_.end(), [&](const Running& running) {
    return running.source == source && running.thread == std::this_thread::get_id();
  });
  to_release = std::move(ended->until_end);
  running_.erase(ended);
  if (waiters_ != 0) {
    CallbackWaits::instance().end_of(this);
    callback_ended_->notify_all();
  }
  if (executor_ != nullptr && executor_ != &executor)
    executor_->wake();  // it has seen nothing meanwhile
}

bool GroupCallbacks::has_work(const ExecutorCore& executor,
                              CallbackSource::Clock::time_point& due) const noexcept {
  const std::lock_guard lock(mutex_);
  if (executor_ != &executor || !is_free()) return false;
  return std::any_of(sources_.begin(), sources_.end(), [&](const auto& source) {
    if (!is_free(*source)) return false;
    if (source->has_work()) return true;
    due = std::min(due, source->due());
    return false;
  });
}

std::size_t GroupCallbacks::ready_count(const ExecutorCore& executor) const noexcept {
  const std::lock_guard lock(mutex_);
  if (executor_ != &executor || !is_free()) return 0;
  const auto ready = std::count_if(sources_.begin(), sources_.end(), [&](const auto& source) {
    return is_free(*source) && source->has_work();
  });
  return static_cast<std::size_t>(ready);
}

bool GroupCallbacks::is_free() const noexcept {
  return type_ == CallbackGroupType::Reentrant || running_.empty();
}
bool GroupCallbacks::is_free(const CallbackSource& source) const noexcept {
  return !source.is_serial_ ||
         std::none_of(running_.begin(), running_.end(),
                      [&](const Running& running) { return running.source == &source; });
}

}  // namespace agnocast
