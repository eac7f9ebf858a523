// SPDX-License-Identifier: Apache-2.0

#include <agnocast/message_wait.hpp>

#include <base/descriptors/kept_fd.hpp>
#include <client/executors/sleep_tick.hpp>
#include <client/process/forked_child.hpp>
#include <client/session/context.hpp>

#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <new>
#include <utility>

namespace agnocast {
namespace {

// Edge-triggered descriptors that are never read, and those that are.
constexpr std::uint64_t eventfd_tag = 0, datagram_tag = 1, tick_tag = 2;
constexpr int events_max = 4;

}  // namespace

struct MessageWait::State {
  enum class Sleep : std::uint8_t { awake, asleep, woken };

  State(UniqueFd epoll_set, UniqueFd eventfd, SleepTick own_tick,
        std::shared_ptr<WaitSet> doorbells) noexcept
      : epoll(std::move(epoll_set)),
        wake(std::move(eventfd)),
        tick(std::move(own_tick)),
        wait_set(std::move(doorbells)) {}
  ~State() {
    if (!is_forked_child()) wait_set->remove_from(epoll.get());
  }

  UniqueFd epoll, wake;
  SleepTick tick;
  std::shared_ptr<WaitSet> wait_set;
  bool has_rung = false;  // by datagram: to be drained before the next sleep
  // [sync:wake] wake() changes it after the change that it reports; the waiting thread changes it
  // before it looks. So either the look sees that change, or falling asleep sees this one.
  std::atomic<Sleep> sleep{Sleep::awake};
  static_assert(std::atomic<Sleep>::is_always_lock_free, "wake() is for signal handlers");

  void block() noexcept {
    epoll_event events[events_max];
    const int count =
        has_lost_kept() ? unrung_pause(-1) : ::epoll_wait(epoll.get(), events, events_max, -1);
    if (count < 0 && errno != EINTR) unrung_pause(-1);
    for (int i = 0; i < count; ++i) {
      if (events[i].data.u64 == tick_tag) tick.wind_up();
      if (events[i].data.u64 == datagram_tag) has_rung = true;
    }
  }
};

MessageWait::MessageWait(std::unique_ptr<State> state) noexcept : state_(std::move(state)) {}
MessageWait::~MessageWait() = default;

Result<std::unique_ptr<MessageWait>> MessageWait::try_create() noexcept {
  try {
    auto doorbells = Context::instance().idle_wait_set();
    if (!doorbells) return tl::unexpected<Failure>(doorbells.error());
    UniqueFd epoll = keep(UniqueFd(::epoll_create1(EPOLL_CLOEXEC)));
    UniqueFd wake = keep(UniqueFd(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)));
    epoll_event event{};
    event.events = EPOLLIN | EPOLLET;
    event.data.u64 = eventfd_tag;
    if (!epoll || !wake || ::epoll_ctl(epoll.get(), EPOLL_CTL_ADD, wake.get(), &event) != 0)
      return fail(Errc::os_failure, "preparing to wait for messages", errno);
    auto tick = SleepTick::in(epoll.get(), tick_tag);
    if (!tick) return tl::unexpected<Failure>(tick.error());
    const int set = epoll.get();
    auto state = std::make_unique<State>(std::move(epoll), std::move(wake), std::move(*tick),
                                         std::move(*doorbells));
    if (Result<void> added = state->wait_set->add_to(set, eventfd_tag, datagram_tag); !added)
      return tl::unexpected<Failure>(added.error());
    return std::unique_ptr<MessageWait>(new MessageWait(std::move(state)));
  } catch (const std::bad_alloc&) {
    return fail(Errc::os_failure, "preparing to wait for messages", ENOMEM);
  }
}

MessageWait::MessageWait() {
  auto made = try_create();
  if (!made) throw Error(made.error());
  state_ = std::move((*made)->state_);
}

void MessageWait::wake() noexcept {
  using Sleep = State::Sleep;
  if (state_->sleep.exchange(Sleep::woken, std::memory_order_acq_rel) != Sleep::asleep) return;
  const int before = errno;
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t written =
      may_use(state_->wake.get()) ? ::write(state_->wake.get(), &one, sizeof one) : 0;
  errno = before;
}

bool MessageWait::wait(bool (*is_ready)(const void*) noexcept, const void* context,
                       Clock::time_point end) noexcept {
  using Sleep = State::Sleep;
  State& state = *state_;
  for (;;) {
    (void)state.sleep.exchange(Sleep::awake, std::memory_order_acq_rel);  // [sync:wake]
    if (is_ready(context)) return true;
    if (is_forked_child() || (end != Clock::time_point::max() && Clock::now() >= end)) return false;
    // A datagram that is in the socket would end each sleep; it stays until here, so that a busy
    // loop never reads it.
    if (std::exchange(state.has_rung, false)) state.wait_set->drain();
    state.wait_set->arm();
    const bool has_found = is_ready(context);
    Sleep expected = Sleep::awake;
    if (!has_found &&
        state.sleep.compare_exchange_strong(expected, Sleep::asleep, std::memory_order_acq_rel)) {
      state.tick.tick_at(end);
      state.block();
    }
    state.wait_set->disarm();
    if (has_found) return true;
  }
}

}  // namespace agnocast
