// SPDX-License-Identifier: Apache-2.0

#include <client/process/thread_register.hpp>

#include <agnocast/heap.hpp>
#include <base/immortal.hpp>
#include <client/process/forked_child.hpp>

#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <new>
#include <utility>

namespace agnocast {
namespace {

std::uint32_t this_thread() noexcept { return static_cast<std::uint32_t>(::syscall(SYS_gettid)); }

}  // namespace

/// Exists in each thread that has run callbacks.
struct ThreadRegister::LeavingThread {
  LeavingThread() = default;
  LeavingThread(const LeavingThread&) = delete;
  LeavingThread& operator=(const LeavingThread&) = delete;
  ~LeavingThread() { instance().remove_thread(this_thread()); }
};

ThreadRegister& ThreadRegister::instance() noexcept { return immortal<ThreadRegister>(); }

std::uint64_t ThreadRegister::next_number() noexcept {
  static constinit std::atomic<std::uint64_t> last{0};
  return last.fetch_add(1, std::memory_order_relaxed) + 1;
}

void ThreadRegister::set_wake(std::shared_ptr<const ControlWake> wake) noexcept {
  const std::lock_guard lock(mutex_);
  wake_ = std::move(wake);
  if (version() != 0) (*wake_)();
}

void ThreadRegister::changed() noexcept {
  version_.fetch_add(1, std::memory_order_release);
  if (wake_ != nullptr) (*wake_)();
}

void ThreadRegister::add(const Group& group) noexcept {
  if (is_forked_child()) return;
  const LoanPause pause;  // groups outlive any loan of this thread
  try {
    const std::lock_guard lock(mutex_);
    groups_.push_back(group);
    changed();
  } catch (const std::bad_alloc&) {
    // The daemon does not hear of it.
  }
}

void ThreadRegister::remove_group(std::uint64_t executor, std::uint64_t group) noexcept {
  if (is_forked_child()) return;
  const std::lock_guard lock(mutex_);
  if (std::erase_if(groups_, [&](const Group& known) {
        return known.executor == executor && known.group == group;
      }) != 0)
    changed();
}

void ThreadRegister::add_this_thread(std::uint64_t executor) noexcept {
  if (is_forked_child()) return;
  static thread_local const LeavingThread at_thread_end;
  noted_ = executor;
  const Thread thread{executor, this_thread(), next_number()};
  const LoanPause pause;
  try {
    const std::lock_guard lock(mutex_);
    // A thread may spin several executors in turn.
    if (std::any_of(threads_.begin(), threads_.end(), [&](const Thread& known) {
          return known.executor == executor && known.thread == thread.thread;
        }))
      return;
    threads_.push_back(thread);
    changed();
  } catch (const std::bad_alloc&) {
    // The daemon does not hear of it.
  }
}

void ThreadRegister::remove_thread(std::uint32_t thread) noexcept {
  if (is_forked_child()) return;
  const std::lock_guard lock(mutex_);
  if (std::erase_if(threads_, [&](const Thread& known) { return known.thread == thread; }) != 0)
    changed();
}

void ThreadRegister::remove_executor(std::uint64_t executor) noexcept {
  if (is_forked_child()) return;
  const std::lock_guard lock(mutex_);
  const auto is_its = [&](const auto& known) { return known.executor == executor; };
  if (std::erase_if(groups_, is_its) + std::erase_if(threads_, is_its) != 0) changed();
}

void ThreadRegister::copy(std::vector<Group>& groups, std::vector<Thread>& threads) const {
  const std::lock_guard lock(mutex_);
  groups = groups_;
  threads = threads_;
}

}  // namespace agnocast
