// SPDX-License-Identifier: Apache-2.0

#include <client/process/thread_register.hpp>

#include <agnocast/heap.hpp>
#include <base/immortal.hpp>
#include <client/process/forked_child.hpp>

#include <pthread.h>
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

void ThreadRegister::add(std::uint64_t executor, std::uint64_t group, CallbackGroupType type,
                         std::string_view node, std::string_view name) noexcept {
  if (is_forked_child()) return;
  const LoanPause pause;  // groups outlive any loan of this thread
  try {
    auto added = std::make_shared<const Group>(
        Group{executor, group, type, std::string(node), std::string(name)});
    const std::lock_guard lock(mutex_);
    groups_.push_back(std::move(added));
    changed();
  } catch (const std::bad_alloc&) {
    // The daemon does not hear of it.
  }
}

void ThreadRegister::remove_group(std::uint64_t executor, std::uint64_t group) noexcept {
  if (is_forked_child()) return;
  const std::lock_guard lock(mutex_);
  if (std::erase_if(groups_, [&](const auto& known) {
        return known->executor == executor && known->group == group;
      }) != 0)
    changed();
}

void ThreadRegister::add_this_thread(std::uint64_t executor) noexcept {
  if (is_forked_child()) return;
  int cancellable = PTHREAD_CANCEL_ENABLE;
  ::pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, &cancellable);  // waking may be such a point
  try {
    const LoanPause pause;  // also for what the C library allocates for the destructor
    static thread_local const LeavingThread at_thread_end;
    noted_[executor % noted_count] = executor;
    const std::lock_guard lock(mutex_);
    if (threads_.insert({executor, this_thread(), next_number()}).second) changed();
  } catch (const std::bad_alloc&) {
    // The daemon does not hear of it.
  }
  ::pthread_setcancelstate(cancellable, nullptr);
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
  const std::size_t removed =
      std::erase_if(groups_, [&](const auto& group) { return group->executor == executor; }) +
      std::erase_if(threads_, [&](const Thread& thread) { return thread.executor == executor; });
  if (removed != 0) changed();
}

void ThreadRegister::copy(std::vector<std::shared_ptr<const Group>>& groups,
                          std::vector<Thread>& threads) const {
  const std::lock_guard lock(mutex_);
  groups = groups_;
  threads.assign(threads_.begin(), threads_.end());
}

}  // namespace agnocast
