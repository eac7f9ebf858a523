// SPDX-License-Identifier: Apache-2.0

#include <ros2/rmw_agnocast_cpp/core/wait_set.hpp>

#include <agnocast/heap.hpp>

#include <pthread.h>

#include <algorithm>
#include <new>
#include <utility>

namespace agnocast::rmw {
namespace {

// Guards all conditions and what they are attached to. One for all: a condition and a wait set may
// be destroyed at the same time, and a thread that triggers needs the sets of a condition for a
// moment only.
std::mutex& conditions_mutex() noexcept {
  static std::mutex* const mutex = [] {
    // A forked child must not find it locked by a thread that it does not have.
    (void)::pthread_atfork([] { conditions_mutex().lock(); }, [] { conditions_mutex().unlock(); },
                           [] { conditions_mutex().unlock(); });
    return new std::mutex;  // objects of static storage end after it
  }();
  return *mutex;
}

MessageWait::Clock::time_point end_of(std::optional<WaitSet::Duration> timeout) noexcept {
  using Clock = MessageWait::Clock;
  const Clock::time_point now = Clock::now();
  if (!timeout || *timeout > Clock::time_point::max() - now) return Clock::time_point::max();
  return now + *timeout;
}

// Between looks for the sake of the time alone, however often it seems to be due.
constexpr std::chrono::milliseconds look_interval{1};

MessageWait::Clock::time_point due_of(const WaitSet::Readables& readables) noexcept {
  auto due = MessageWait::Clock::time_point::max();
  for (const Readable* const readable : readables) {
    if (readable != nullptr) due = std::min(due, readable->look_due());
  }
  return due;
}

}  // namespace

Condition::~Condition() {
  const std::lock_guard lock(conditions_mutex());
  for (WaitSet* const set : waiting_)
    std::replace(set->attached_.begin(), set->attached_.end(), this,
                 static_cast<Condition*>(nullptr));
}

void Condition::trigger() noexcept {
  const std::lock_guard lock(conditions_mutex());
  is_triggered_ = true;
  for (WaitSet* const set : waiting_) {
    if (set->wait_ != nullptr) set->wait_->wake();
  }
}

bool Condition::is_waited_for() const noexcept {
  const std::lock_guard lock(conditions_mutex());
  return !waiting_.empty();
}

Result<std::unique_ptr<MessageWait>> WaitPool::take() {
  const LoanPause pause;
  {
    const std::lock_guard lock(conditions_mutex());
    if (!free_.empty()) {
      auto wait = std::move(free_.back());
      free_.pop_back();
      return wait;
    }
  }
  return MessageWait::try_create();
}

void WaitPool::give_back(std::unique_ptr<MessageWait> wait) noexcept {
  const LoanPause pause;
  const std::lock_guard lock(conditions_mutex());
  try {
    free_.push_back(std::move(wait));
  } catch (const std::bad_alloc&) {
    // It ends here.
  }
}

WaitSet::~WaitSet() {
  if (wait_ != nullptr) pool_.give_back(std::move(wait_));
}

void WaitSet::attach(const Conditions& conditions) {
  const std::lock_guard lock(conditions_mutex());
  attached_.reserve(conditions.size());
  // Reserved before anything is attached that would have to be detached again.
  for (Condition* const condition : conditions) {
    if (condition != nullptr) condition->waiting_.reserve(condition->waiting_.size() + 1);
  }
  for (Condition* const condition : conditions) {
    attached_.push_back(condition);
    if (condition == nullptr) continue;
    auto& waiting = condition->waiting_;
    const bool is_repeated = !waiting.empty() && waiting.back() == this;
    if (!is_repeated) waiting.push_back(this);
  }
}

void WaitSet::detach() noexcept {
  const std::lock_guard lock(conditions_mutex());
  for (Condition* const condition : attached_) {
    if (condition != nullptr) std::erase(condition->waiting_, this);
  }
  attached_.clear();
}

bool WaitSet::has_trigger() const noexcept {
  const std::lock_guard lock(conditions_mutex());
  return std::any_of(attached_.begin(), attached_.end(), [](const Condition* condition) {
    return condition != nullptr && condition->is_triggered_;
  });
}

/// Notes what is ready, and consumes it. Returns whether anything is.
bool WaitSet::look(const Readables& readables) noexcept {
  bool has_any = false;
  for (std::size_t i = 0; i < readables.size(); ++i) {
    ready_readables_[i] = readables[i] != nullptr && readables[i]->is_ready();
    has_any = has_any || ready_readables_[i];
  }
  const std::lock_guard lock(conditions_mutex());
  for (std::size_t i = 0; i < attached_.size(); ++i) {
    ready_conditions_[i] = attached_[i] != nullptr && attached_[i]->is_triggered_;
    has_any = has_any || ready_conditions_[i];
  }
  // After all: one that repeats is reported at each of its places.
  for (Condition* const condition : attached_) {
    if (condition != nullptr) condition->is_triggered_ = false;
  }
  return has_any;
}

Result<bool> WaitSet::wait(const Conditions& conditions, const Readables& readables,
                           std::optional<Duration> timeout) {
  const LoanPause pause;  // the lists are private memory
  const bool looks_only = timeout && *timeout <= Duration::zero();
  if (!looks_only && wait_ == nullptr) {
    auto wait = pool_.take();
    if (!wait) return tl::unexpected<Failure>(wait.error());
    wait_ = std::move(*wait);
  }
  ready_conditions_.assign(conditions.size(), false);
  ready_readables_.assign(readables.size(), false);
  attach(conditions);
  auto due = MessageWait::Clock::time_point::max();
  const auto has_any = [&]() noexcept {
    // A period may begin while it sleeps.
    return has_trigger() || due_of(readables) < due ||
           std::any_of(readables.begin(), readables.end(), [](const Readable* readable) {
             return readable != nullptr && readable->is_ready();
           });
  };
  const auto end = end_of(timeout);
  bool is_over = looks_only;
  bool found = look(readables);
  // Another thread may take the message that ended the sleep.
  auto earliest = MessageWait::Clock::time_point::min();
  while (!found && !is_over) {
    due = due_of(readables);
    const auto until = std::min(end, std::max(due, earliest));
    if (!wait_->wait_until(until, has_any))
      is_over = until == end || MessageWait::Clock::now() < until;  // a forked child never sleeps
    found = look(readables);
    earliest = MessageWait::Clock::now() + look_interval;
  }
  detach();
  if (!found && !timeout) return fail(Errc::shut_down, "waiting in a forked child");
  return found;
}

}  // namespace agnocast::rmw
