// SPDX-License-Identifier: Apache-2.0

#include <client/executors/executor_core.hpp>

#include <base/descriptors/kept_fd.hpp>
#include <client/process/forked_child.hpp>

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
int wait(int epoll, epoll_event (&events)[events_max], int timeout_ms) noexcept {
  const bool usable = !has_lost_kept();
  const int count = usable ? ::epoll_wait(epoll, events, events_max, timeout_ms) : -1;
  if (count >= 0 || (usable && errno == EINTR)) return count;
  return unrung_pause(timeout_ms);
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

ExecutorCore::~ExecutorCore() = default;

Result<void> ExecutorCore::adopt(std::shared_ptr<NodeCallbacks> node) {
  {
    const std::lock_guard lock(mutex_);
    const std::uint64_t tag = ++last_tag_;
    assigned_.reserve(assigned_.size() + 1);
    if (Result<void> added = node->wait_set()->add_to(epoll_.get(), eventfd_tag, tag); !added)
      return added;
    assigned_.push_back({node, tag});
  }
  node->hand_to(this);
  return {};
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

void ExecutorCore::begin_cycle() {
  next_ = 0;
  const std::lock_guard lock(mutex_);
  if (is_cycle_current()) [[likely]]
    return;
  cycle_is_listed_ = false;  // in case memory runs out half way
  cycle_.clear();
  for (Assigned& assigned : assigned_) {
    listed_.clear();
    assigned.listed = assigned.node->list(this, listed_);
    for (auto& source : listed_) cycle_.push_back({assigned.node, std::move(source)});
  }
  cycle_is_listed_ = true;
}

bool ExecutorCore::is_cycle_current() const noexcept {
  return cycle_is_listed_ &&
         std::all_of(assigned_.begin(), assigned_.end(), [](const Assigned& assigned) {
           return assigned.node->list_changes() == assigned.listed;
         });
}

bool ExecutorCore::run_one_of_cycle() {
  while (next_ < cycle_.size()) {
    const Cycle& entry = cycle_[next_++];
    const auto node = entry.node.lock();
    const auto source = entry.source.lock();
    if (node == nullptr || source == nullptr) continue;
    // A single source is asked by taking: it rarely has nothing, and then that only costs more.
    if (cycle_.size() > 1 && !source->has_work()) continue;
    if (!node->run(this, *source)) continue;
    // The callback may have forked, and returned in the child.
    if (Result<void> refused = refuse_forked_child(); !refused) throw Error(refused.error());
    return true;
  }
  return false;
}

bool ExecutorCore::run_next() {
  if (run_one_of_cycle()) return true;
  begin_cycle();
  return run_one_of_cycle();
}

std::size_t ExecutorCore::run_cycle(Clock::time_point deadline) {
  std::size_t count = 0;
  const auto is_over = [&] { return is_cancelled() || Clock::now() >= deadline; };
  while (!is_over() && run_one_of_cycle()) ++count;
  if (count != 0 || is_over()) return count;
  begin_cycle();
  while (run_one_of_cycle()) {
    ++count;
    if (is_over()) break;
  }
  return count;
}

bool ExecutorCore::has_work() const noexcept {
  const std::lock_guard lock(mutex_);
  return std::any_of(assigned_.begin(), assigned_.end(),
                     [this](const Assigned& assigned) { return assigned.node->has_work(this); });
}

bool ExecutorCore::prepare() noexcept {
  const std::lock_guard lock(mutex_);
  drain_rung();
  const bool work = std::any_of(
      assigned_.begin(), assigned_.end(),
      [this](const Assigned& assigned) { return assigned.node->arm_or_find_work(this); });
  if (!work) return false;
  for (const Assigned& assigned : assigned_) assigned.node->disarm(this);
  return true;
}

void ExecutorCore::sleep(std::optional<std::chrono::milliseconds> timeout) noexcept {
  epoll_event events[events_max];
  const int count = wait(epoll_.get(), events, timeout ? static_cast<int>(timeout->count()) : -1);
  const std::lock_guard lock(mutex_);
  for (const Assigned& assigned : assigned_) assigned.node->disarm(this);
  // Under the lock that is held anyway. An unfinished cycle continues where it was.
  if (next_ >= cycle_.size() && is_cycle_current()) next_ = 0;
  for (int i = 0; i < count; ++i) {
    const std::uint64_t tag = events[i].data.u64;
    if (tag == eventfd_tag) continue;
    if (tag == tick_tag) {
      tick_.wind_up();
      continue;
    }
    const auto found = std::find_if(assigned_.begin(), assigned_.end(),
                                    [&](const Assigned& assigned) { return assigned.tag == tag; });
    if (found != assigned_.end()) found->has_rung = true;
  }
}

void ExecutorCore::end_dispatch() noexcept {
  const std::lock_guard lock(mutex_);
  drain_rung();
}

void ExecutorCore::drain_rung() noexcept {
  for (Assigned& assigned : assigned_) {
    if (std::exchange(assigned.has_rung, false)) assigned.node->drain(this);
  }
}

}  // namespace agnocast
