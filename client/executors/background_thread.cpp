// SPDX-License-Identifier: Apache-2.0

#include <client/executors/background_thread.hpp>

#include <base/signals.hpp>
#include <client/executors/callback_waits.hpp>
#include <client/process/forked_child.hpp>
#include <client/process/library_thread.hpp>
#include <client/process/user_code.hpp>

#include <cxxabi.h>
#include <pthread.h>

#include <cerrno>
#include <new>
#include <optional>
#include <system_error>
#include <utility>

namespace agnocast {

// --- consecutive threads

/// Lives during the whole function of one thread.
struct BackgroundThread::Life {
  const std::shared_ptr<BackgroundThread>& self;
  bool has_returned = false;

  ~Life() {
    if (is_forked_child()) return;
    const std::lock_guard lock(self->mutex_);
    // Otherwise a callback has called pthread_exit(), or the thread was cancelled.
    if (!has_returned && !self->is_joined_ && !exit_has_begun() && start_next(self)) return;
    self->has_ended_ = true;
    self->ended_.notify_all();
  }
};

Result<std::shared_ptr<BackgroundThread>> BackgroundThread::start(
    std::shared_ptr<ExecutorCore> core) {
  const auto made = std::make_shared<BackgroundThread>(std::move(core));
  const std::lock_guard lock(made->mutex_);
  if (Result<void> started = start_next(made); !started)
    return tl::unexpected<Failure>(started.error());
  return made;
}

/// Call it under the mutex.
Result<void> BackgroundThread::start_next(const std::shared_ptr<BackgroundThread>& self) {
  int error = 0;
  self->before_ = std::move(self->thread_);
  try {
    const SignalsBlocked blocked;
    self->thread_ = std::thread([self] { self->run(self); });
  } catch (const std::system_error& refused) {
    error = refused.code().value();
  } catch (const std::bad_alloc&) {
    error = ENOMEM;
  }
  if (error != 0) {
    self->thread_ = std::move(self->before_);
    return fail(Errc::os_failure, "starting a callback thread", error);
  }
  ::pthread_setname_np(self->thread_.native_handle(), "agnocast-call");
  return {};
}

void BackgroundThread::run(const std::shared_ptr<BackgroundThread>& self) {
  ::pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, nullptr);  // but in ExecutorCore::wait()
  const LibraryThread registered(
      [](void* core) noexcept { static_cast<ExecutorCore*>(core)->cancel(); }, core_.get(),
      LibraryThread::Sleep::can_be_cancelled);
  std::thread before;
  {
    const std::lock_guard lock(mutex_);
    before.swap(before_);
  }
  if (before.joinable()) before.join();
  Life life{self};
  serve();
  life.has_returned = true;
}

void BackgroundThread::join() noexcept {
  core_->cancel();
  std::thread thread;
  std::unique_lock lock(mutex_);
  is_joined_ = true;
  thread.swap(thread_);
  if (!thread.joinable()) return;
  CallbackWaits& waits = CallbackWaits::instance();
  if (thread.get_id() == std::this_thread::get_id() || !waits.begin(thread.get_id(), nullptr))
    return thread.detach();
  while (!ended_.wait_for(lock, ExitPatience::look, [this] { return has_ended_; })) {
    if (!ExitPatience::is_over()) continue;
    waits.end();
    return thread.detach();
  }
  waits.end();
  lock.unlock();
  thread.join();
}

// --- callbacks

/// Returns whether there was a callback. Exceptions have no receiver, and the library must not end
/// the process: they are counted.
bool BackgroundThread::run_next() {
  const UserCode code;  // destroyed after the claim, whose source may own the callback
  if (!code.may_run()) return false;
  const ExecutorCore::Claim claim = core_->next();
  if (!claim || is_forked_child()) return false;
  take_on_signals(claim.source().signals);
  try {
    return claim.source().run_one();
  } catch (const ::abi::__forced_unwind&) {
    throw;  // the callback ends its thread: pthread_exit()
  } catch (...) {
    claim.source().exception_count.fetch_add(1, std::memory_order_relaxed);
    return true;
  }
}

void BackgroundThread::serve() {
  ThreadRegister::note(core_->number());
  while (!core_->is_cancelled()) {
    bool had_one = false;
    try {
      had_one = run_next();
    } catch (const std::bad_alloc&) {
      // Messages stay unread until there is memory.
    }
    if (is_forked_child()) return;  // a callback has forked, and has returned in the child
    if (exit_has_begun() || LibraryThread::is_over()) return;  // unread messages stay unread
    if (had_one) continue;
    shed_signals();
    core_->wait(std::nullopt, true);
    LibraryThread::look_for_users();  // there may be no control thread yet
  }
}

}  // namespace agnocast
