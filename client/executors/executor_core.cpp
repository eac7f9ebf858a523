// SPDX-License-Identifier: Apache-2.0

#include <client/executors/executor_core.hpp>

#include <base/descriptors/kept_fd.hpp>
#include <client/process/forked_child.hpp>

#include <pthread.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <utility>

namespace agnocast {
namespace {

// Tag of all edge-triggered descriptors, which are never read: the caller need not know which one
// fired.
constexpr std::uint64_t eventfd_tag = 0;
constexpr std::uint64_t tick_tag = ~std::uint64_t{0};
constexpr int events_max = 16;

/// Like epoll_wait; pauses if the program has closed the descriptors, because nothing can ring
/// then.
int wait_for_events(int epoll, epoll_event (&events)[events_max], int timeout_ms,
                    bool in_cancellable_thread) {
  if (has_lost_kept()) return unrung_pause(timeout_ms);
  // The only place where a library thread can be cancelled, so that cancellation leaves no
  // function of the library half done.
  if (in_cancellable_thread) ::pthread_setcancelstate(PTHREAD_CANCEL_ENABLE, nullptr);
  const int count = ::epoll_wait(epoll, events, events_max, timeout_ms);
  if (in_cancellable_thread) ::pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, nullptr);
  return count >= 0 || errno == EINTR ? count : unrung_pause(timeout_ms);
}

}  // namespace

Result<std::unique_ptr<ExecutorCore>> ExecutorCore::make() {
  UniqueFd epoll = keep(UniqueFd(::epoll_create1(EPOLL_CLOEXEC)));
  UniqueFd wake = keep(UniqueFd(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)));
  if (!epoll || !wake) return fail(Errc::os_failure, "preparing an executor", errno);
  auto tick = SleepTick::in(epoll.get(), tick_tag);
  if (!tick) return tl::unexpected<Failure>(tick.error());
  epoll_event event{};
  event.events = EPOLLIN | EPOLLET;
  event.data.u64 = eventfd_tag;
  if (::epoll_ctl(epoll.get(), EPOLL_CTL_ADD, wake.get(), &event) != 0)
    return fail(Errc::os_failure, "preparing an executor", errno);
  return std::unique_ptr<ExecutorCore>(
      new ExecutorCore(std::move(epoll), std::move(wake), std::move(*tick)));
}

ExecutorCore::~ExecutorCore() { ThreadRegister::instance().remove_executor(number_); }

// --- groups and their doorbells

Result<void> ExecutorCore::adopt(const std::shared_ptr<GroupCallbacks>& group) {
  const std::lock_guard lock(mutex_);
  assigned_.reserve(assigned_.size() + 1);
  std::shared_ptr<WaitSet> wait_set = group->wait_set();
  if (wait_set != nullptr) {
    if (Result<void> listening = begin_listening(wait_set); !listening) return listening;
  }
  assigned_.push_back({group, std::move(wait_set)});
  group->hand_to(this);
  ThreadRegister::instance().add(number_, group->number(), group->type(), group->node(),
                                 group->name());
  return {};
}

Result<void> ExecutorCore::listen(const GroupCallbacks& group, std::shared_ptr<WaitSet> wait_set) {
  const std::lock_guard lock(mutex_);
  for (Assigned& assigned : assigned_) {
    if (assigned.group.get() != &group || assigned.wait_set == wait_set) continue;
    if (Result<void> listening = begin_listening(wait_set); !listening) return listening;
    // That of a creation which has failed, but after this core got the group.
    if (assigned.wait_set != nullptr) end_listening(assigned.wait_set);
    assigned.wait_set = std::move(wait_set);
    wake();
  }
  return {};
}

void ExecutorCore::drop(GroupCallbacks& group) noexcept {
  const std::lock_guard lock(mutex_);
  const auto found = std::find_if(assigned_.begin(), assigned_.end(), [&](const auto& assigned) {
    return assigned.group.get() == &group;
  });
  if (found == assigned_.end()) return;
  group.hand_to(nullptr);
  ThreadRegister::instance().remove_group(number_, group.number());
  if (found->wait_set != nullptr) end_listening(found->wait_set);
  const auto index = static_cast<std::size_t>(found - assigned_.begin());
  if (index < next_) --next_;
  assigned_.erase(found);
}

Result<void> ExecutorCore::begin_listening(std::shared_ptr<WaitSet> wait_set) {
  for (Listened& listened : listened_) {
    if (listened.wait_set == wait_set) return ++listened.groups, Result<void>();
  }
  listened_.reserve(listened_.size() + 1);
  const std::uint64_t tag = ++last_tag_;
  if (Result<void> added = wait_set->add_to(epoll_.get(), eventfd_tag, tag); !added) return added;
  listened_.push_back({std::move(wait_set), tag});
  return {};
}

void ExecutorCore::end_listening(const std::shared_ptr<WaitSet>& wait_set) noexcept {
  const auto found =
      std::find_if(listened_.begin(), listened_.end(),
                   [&](const Listened& listened) { return listened.wait_set == wait_set; });
  if (--found->groups != 0) return;
  if (found->is_armed) wait_set->disarm();
  wait_set->remove_from(epoll_.get());
  listened_.erase(found);
}

void ExecutorCore::wake() noexcept {
  const int before = errno;
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t written =
      may_use(wake_.get()) ? ::write(wake_.get(), &one, sizeof one) : 0;
  errno = before;
}

void ExecutorCore::cancel() noexcept {
  cancelled_.store(true, std::memory_order_release);
  wake();
}

// --- callbacks

ExecutorCore::Claim ExecutorCore::begin_of_cycle() {
  for (; next_ < assigned_.size(); ++next_) {
    const auto& group = assigned_[next_].group;
    if (auto source = group->begin(*this, cycle_, assigned_.size() == 1 && !is_shared()))
      return Claim(*this, group, std::move(source));
  }
  return {};
}

/// Lets another thread look for more while this one runs a callback.
void ExecutorCore::pass_on() noexcept {
  if (is_asleep_ || successors_ == 0) return;
  ++passed_on_;
  passed_->notify_one();
}

ExecutorCore::Claim ExecutorCore::begin_oldest() {
  const std::lock_guard lock(mutex_);
  ++cycle_;
  for (const auto& [group, wait_set] : assigned_) {
    if (auto source = group->begin_oldest(*this, cycle_)) {
      pass_on();
      return Claim(*this, group, std::move(source));
    }
  }
  return {};
}

ExecutorCore::Claim ExecutorCore::next() {
  const std::lock_guard lock(mutex_);
  for (int cycles = 0; cycles < 2; ++cycles) {
    if (Claim claim = begin_of_cycle()) {
      pass_on();
      return claim;
    }
    ++cycle_;
    next_ = 0;
  }
  return {};
}

bool ExecutorCore::run_next() { return run_claimed(&ExecutorCore::next); }
bool ExecutorCore::run_oldest() { return run_claimed(&ExecutorCore::begin_oldest); }

bool ExecutorCore::run_claimed(Claim (ExecutorCore::*claim_one)()) {
  ThreadRegister::note(number_);
  // Twice with several threads: what came for the busy group meanwhile, no other has seen. Not for
  // ever: while there is no memory for a message, there is work that nobody can do.
  for (int attempts = is_shared() ? 2 : 1; attempts > 0; --attempts) {
    const Claim claim = (this->*claim_one)();
    if (!claim) return false;
    if (!claim.source().run_one()) continue;
    // The callback may have forked, and returned in the child.
    if (Result<void> refused = refuse_forked_child(); !refused) throw Error(refused.error());
    return true;
  }
  return false;
}

std::size_t ExecutorCore::run_cycle(Clock::time_point deadline) {
  ThreadRegister::note(number_);
  std::size_t count = 0;
  const auto is_over = [&] { return is_cancelled() || Clock::now() >= deadline; };
  // The rest of a cycle, then a new one.
  for (int cycles = 0; cycles < 2 && count == 0; ++cycles) {
    while (!is_over()) {
      const Claim claim = [&] {
        const std::lock_guard lock(mutex_);
        return begin_of_cycle();
      }();
      if (!claim) break;
      if (!claim.source().run_one()) continue;
      if (Result<void> refused = refuse_forked_child(); !refused) throw Error(refused.error());
      ++count;
    }
    if (count != 0 || is_over()) break;
    const std::lock_guard lock(mutex_);
    ++cycle_;
    next_ = 0;
  }
  return count;
}

bool ExecutorCore::has_work_here(Clock::time_point& due) const noexcept {
  return std::any_of(assigned_.begin(), assigned_.end(), [&](const Assigned& assigned) {
    return assigned.group->has_work(*this, due);
  });
}

bool ExecutorCore::has_work() const noexcept {
  Clock::time_point due = Clock::time_point::max();
  const std::lock_guard lock(mutex_);
  return has_work_here(due);
}

std::size_t ExecutorCore::ready_count() const noexcept {
  std::size_t count = 0;
  const std::lock_guard lock(mutex_);
  for (const Assigned& assigned : assigned_) count += assigned.group->ready_count(*this);
  return count;
}

// --- sleep

bool ExecutorCore::arm_or_find_work() noexcept {
  drain_rung();
  disarm();  // after a prepare() without dispatch(): publishers have rung for that value already
  for (Listened& listened : listened_) {
    listened.wait_set->arm();
    listened.is_armed = true;
  }
  Clock::time_point due = Clock::time_point::max();
  if (has_work_here(due)) {
    disarm();
    return true;
  }
  tick_.tick_at(due);
  return false;
}

void ExecutorCore::disarm() noexcept {
  for (Listened& listened : listened_) {
    if (std::exchange(listened.is_armed, false)) listened.wait_set->disarm();
  }
}

void ExecutorCore::note_events(const epoll_event* events, int count) noexcept {
  for (int i = 0; i < count; ++i) {
    const std::uint64_t tag = events[i].data.u64;
    if (tag == eventfd_tag) continue;
    if (tag == tick_tag) {
      tick_.wind_up();
      continue;
    }
    const auto found = std::find_if(listened_.begin(), listened_.end(),
                                    [&](const Listened& listened) { return listened.tag == tag; });
    if (found != listened_.end()) found->has_rung = true;
  }
}

/// Ends the sleep of a thread, also when the thread is cancelled.
class ExecutorCore::Sleeping {
 public:
  explicit Sleeping(ExecutorCore& core) noexcept : core_(core) {}
  ~Sleeping() {
    if (is_forked_child()) return;  // the lock may belong to the parent
    const std::lock_guard lock(core_.mutex_);
    core_.disarm();
    core_.note_events(events, count);
    core_.is_asleep_ = false;
  }
  Sleeping(const Sleeping&) = delete;
  Sleeping& operator=(const Sleeping&) = delete;

  epoll_event events[events_max];
  int count = 0;

 private:
  ExecutorCore& core_;
};

void ExecutorCore::wait(std::optional<std::chrono::milliseconds> timeout,
                        bool in_cancellable_thread) {
  {
    std::unique_lock lock(mutex_);
    if (is_asleep_) {
      // The thread that sleeps has not seen the timers of the group that this one has freed.
      Clock::time_point due = Clock::time_point::max();
      if (has_work_here(due)) return;
      tick_.tick_at(due);
      ++successors_;
      passed_->wait(lock, [&, before = passed_on_] {
        return passed_on_ != before || !is_asleep_ || is_cancelled();
      });
      --successors_;
      return;
    }
    if (arm_or_find_work()) return;
    is_asleep_ = true;
  }
  Sleeping sleeping(*this);
  sleeping.count =
      wait_for_events(epoll_.get(), sleeping.events,
                      timeout ? static_cast<int>(timeout->count()) : -1, in_cancellable_thread);
}

void ExecutorCore::leave() noexcept {
  if (is_forked_child()) return;  // the lock may belong to the parent
  const std::lock_guard lock(mutex_);
  ++passed_on_;
  passed_->notify_all();
  wake();
}

bool ExecutorCore::prepare() noexcept {
  const std::lock_guard lock(mutex_);
  return arm_or_find_work();
}

void ExecutorCore::finish_sleep() noexcept {
  epoll_event events[events_max];
  const int count = has_lost_kept() ? 0 : ::epoll_wait(epoll_.get(), events, events_max, 0);
  const std::lock_guard lock(mutex_);
  disarm();
  note_events(events, count);
}

void ExecutorCore::end_dispatch() noexcept {
  const std::lock_guard lock(mutex_);
  drain_rung();
}

void ExecutorCore::drain_rung() noexcept {
  for (Listened& listened : listened_) {
    if (std::exchange(listened.has_rung, false)) listened.wait_set->drain();
  }
}

}  // namespace agnocast
