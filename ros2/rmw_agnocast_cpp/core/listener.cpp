// SPDX-License-Identifier: Apache-2.0

#include <ros2/rmw_agnocast_cpp/core/listener.hpp>

#include <agnocast/heap.hpp>
#include <base/signals.hpp>

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <new>
#include <system_error>
#include <utility>

namespace agnocast::rmw {

using Clock = MessageWait::Clock;

Listener::Listener(WaitPool& pool) noexcept : pool_(pool), process_(::getpid()) {}

Listener::~Listener() {
  if (wait_ == nullptr) return;
  if (::getpid() != process_) {  // a forked child, where there is no such thread
    thread_.detach();
    return;
  }
  {
    const std::lock_guard lock(mutex_);
    is_over_ = true;
    has_entries_.notify_one();
  }
  wait_->wake();
  thread_.join();
  pool_.give_back(std::move(wait_));
}

Result<void> Listener::listen(Listenable& to, Callback callback, const void* user_data) {
  if (callback == nullptr) {
    forget(to);
    return {};
  }
  if (::getpid() != process_) return fail(Errc::shut_down, "listening in a forked child");
  const LoanPause pause;  // what it keeps is private memory
  Entry wanted{&to, callback, user_data, {}};
  ::pthread_sigmask(SIG_SETMASK, nullptr, &wanted.signals);
  std::unique_lock lock(mutex_);
  if (wait_ == nullptr) {
    if (Result<void> begun = begin(); !begun) return begun;
  }
  auto entry = std::find_if(entries_.begin(), entries_.end(),
                            [&](const Entry& one) { return one.to == &to; });
  if (entry == entries_.end()) entry = entries_.insert(entries_.end(), Entry{});
  *entry = wanted;
  const Arrivals now = to.arrivals();
  const std::uint64_t gone = now.count - std::min(now.count, now.unread);
  if (to.reported_ < gone || to.reported_ > now.count) to.reported_ = gone;
  is_changed_ = true;
  has_entries_.notify_one();
  wait_->wake();
  wait_for_callback(lock, to);
  return {};
}

void Listener::forget(Listenable& to) noexcept {
  if (::getpid() != process_) return;
  std::unique_lock lock(mutex_);
  std::erase_if(entries_, [&](const Entry& one) { return one.to == &to; });
  wait_for_callback(lock, to);
}

void Listener::wait_for_callback(std::unique_lock<std::mutex>& lock,
                                 const Listenable& of) noexcept {
  if (std::this_thread::get_id() == thread_.get_id()) return;
  callback_ended_.wait(lock, [&, call = call_] { return running_ != &of || call_ != call; });
}

Result<void> Listener::begin() {
  auto wait = pool_.take();
  if (!wait) return tl::unexpected<Failure>(wait.error());
  wait_ = std::move(*wait);
  try {
    const SignalsBlocked blocked;  // the thread inherits them
    thread_ = std::thread([this] { run(); });
    return {};
  } catch (const std::system_error& error) {
    pool_.give_back(std::move(wait_));
    return fail(Errc::os_failure, "starting the thread of callbacks", error.code().value());
  } catch (const std::bad_alloc&) {
    pool_.give_back(std::move(wait_));
    throw;
  }
}

bool Listener::has_news() const noexcept {
  const std::lock_guard lock(mutex_);
  return is_over_ || is_changed_ ||
         std::any_of(entries_.begin(), entries_.end(), [](const Entry& entry) {
           return entry.to->arrivals().count != entry.to->reported_;
         });
}

Clock::time_point Listener::due() const noexcept {
  const std::lock_guard lock(mutex_);
  auto due = Clock::time_point::max();
  for (const Entry& entry : entries_) due = std::min(due, entry.to->look_due());
  return due;
}

/// Calls the callbacks of what has news. They may change the entries: one that is passed over for
/// that reason still has its news.
void Listener::report() noexcept {
  std::unique_lock lock(mutex_);
  is_changed_ = false;
  for (std::size_t i = 0; i < entries_.size() && !is_over_; ++i) {
    const Entry entry = entries_[i];
    const Arrivals now = entry.to->arrivals();
    std::uint64_t before = std::exchange(entry.to->reported_, now.count);
    if (now.count < before) before = now.count - std::min(now.count, now.unread);
    if (now.count == before) continue;
    running_ = entry.to;
    ++call_;
    lock.unlock();
    sigset_t own;
    ::pthread_sigmask(SIG_SETMASK, &entry.signals, &own);
    entry.callback(entry.user_data, now.count - before);
    ::pthread_sigmask(SIG_SETMASK, &own, nullptr);
    lock.lock();
    running_ = nullptr;
    callback_ended_.notify_all();
  }
}

void Listener::run() noexcept {
  // Between looks for the sake of the time alone, however often it seems to be due.
  constexpr std::chrono::milliseconds look_interval{1};
  for (;;) {
    {
      // Each message of the process ends a sleep in wait_.
      std::unique_lock lock(mutex_);
      has_entries_.wait(lock, [this] { return is_over_ || !entries_.empty(); });
    }
    const auto first = due();
    // A period may begin while it sleeps.
    wait_->wait_until(std::max(first, Clock::now() + look_interval),
                      [&] { return has_news() || due() < first; });
    {
      const std::lock_guard lock(mutex_);
      if (is_over_) return;
    }
    report();
  }
}

}  // namespace agnocast::rmw
