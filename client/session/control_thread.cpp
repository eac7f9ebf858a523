// SPDX-License-Identifier: Apache-2.0

#include <client/heap/heap_return.hpp>
#include <client/process/library_thread.hpp>
#include <client/session/context.hpp>
#include <client/session/control_thread.hpp>
#include <client/session/reregistration.hpp>

#include <base/descriptors/kept_fd.hpp>
#include <client/process/steps.hpp>

#include <poll.h>
#include <sys/epoll.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <new>
#include <utility>

namespace agnocast {

namespace wire = abi::wire;
using wire::Opcode;

namespace {

// Interval for a socket whose queue the daemon has not emptied.
constexpr int output_look_ms = 10;
// Pause before the next attempt when there is no memory.
constexpr int memory_pause_ms = 10;
// For one announcement of a subscription: its region and two doorbells.
constexpr unsigned announced_descriptors = 3;

}  // namespace

Result<void> ControlThread::prepare() {
  epoll_ = keep(UniqueFd(::epoll_create1(EPOLL_CLOEXEC)));
  if (!epoll_) return fail(Errc::os_failure, "preparing the control thread", errno);
  peers_.begin({registration_.client(), &registration_.region(), registration_.arena(),
                registration_.wake()});
  for (const int fd : {registration_.connection().fd(), registration_.wake()->fd()}) {
    if (Result<void> watched = watch(fd); !watched) return watched;
  }
  ThreadRegister::instance().set_wake(registration_.wake());
  return {};
}

Result<void> ControlThread::watch(int fd) noexcept {
  epoll_event event{};
  event.events = EPOLLIN;
  event.data.fd = fd;
  if (::epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, fd, &event) != 0)
    return fail(Errc::os_failure, "preparing the control thread", errno);
  return {};
}

void ControlThread::serve() noexcept {
  for (;;) {
    try {
      serve_once(scan_due_ms());
      if (state_.is_dropped()) return;
      LibraryThread::look_for_users();
      if (LibraryThread::is_over()) return serve_nobody();
      if (is_former() && collector_.is_unused() && unmap_everything()) return;
    } catch (const std::bad_alloc&) {
      // A packet may be half handled. After a new connection the daemon announces everything again.
      lose_connection();
      ::poll(nullptr, 0, memory_pause_ms);
    }
  }
}

// The process is about to end: requests of its exit handlers fail at once.
void ControlThread::serve_nobody() noexcept {
  registration_.connection().refuse(
      {Errc::shut_down, 0, "the last thread of this process has ended"});
  tell_state(ConnectionState::orphaned);
}

// Returns after how many milliseconds the publishers need the next look.
int ControlThread::scan_due_ms() {
  const auto all = endpoints_.publishers();
  const bool reclaimable = std::any_of(
      all.begin(), all.end(), [](const auto& publisher) { return publisher->has_reclaimable(); });
  const bool awaits_link = std::any_of(
      all.begin(), all.end(), [](const auto& publisher) { return publisher->awaits_link(); });
  return scan_timer_.next_ms(reclaimable, awaits_link, state_.is_alone());
}

void ControlThread::serve_once(int timeout_ms) {
  if (reconnection_.state() == Reconnection::State::waiting) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(reconnection_.next_try() -
                                                                   Reconnection::Clock::now());
    timeout_ms = std::clamp(static_cast<int>(left.count()), 0, timeout_ms);
  }
  if (is_output_blocked_) timeout_ms = std::min(timeout_ms, output_look_ms);
  epoll_event events[4];
  int count = 0;
  if (has_lost_kept()) {
    ::poll(nullptr, 0, std::min(timeout_ms, ScanTimer::first_ms));
  } else {
    count = ::epoll_wait(epoll_.get(), events, 4, timeout_ms);
    if (count < 0 && errno != EINTR) ::poll(nullptr, 0, output_look_ms);
  }
  look_for_descriptors(count < 0 && errno != EINTR);
  for (int i = 0; i < count; ++i) {
    if (events[i].data.fd == registration_.wake()->fd()) {
      std::uint64_t ignored = 0;
      [[maybe_unused]] const ssize_t got =
          ::read(registration_.wake()->fd(), &ignored, sizeof ignored);
    } else {
      read_connection();
    }
  }
  if (reannouncement_.is_due(Reannouncement::Clock::now())) {
    if (can_open(announced_descriptors)) {
      reannouncement_.begun();
      lose_connection();
    } else {
      reannouncement_.postpone(Reannouncement::Clock::now());
    }
  }
  if (reconnection_.is_due(Reconnection::Clock::now())) reconnect();
  run_upkeep();
  is_output_blocked_ = registration_.connection().flush();
}

/// Checks at each tick, or `now`, whether user code has closed descriptors of this library, whose
/// numbers other files may have by now.
void ControlThread::look_for_descriptors(bool now) noexcept {
  const auto time = std::chrono::steady_clock::now();
  if (!now && time - descriptors_looked_ < std::chrono::milliseconds{ScanTimer::last_ms}) return;
  descriptors_looked_ = time;
  if (!lost_kept() || descriptors_lost_) return;
  descriptors_lost_ = true;
  become_orphaned(
      {Errc::os_failure, EBADF, "this process has closed descriptors that belong to agnocast"});
  LibraryThread::end_sleeps();
  endpoints_.wake_wait_sets();
}

void ControlThread::read_connection() {
  while (registration_.connection().fd() >= 0) {
    Incoming packet;
    bool unasked = false;
    const Result<bool> alive = registration_.connection().receive(packet, unasked);
    if (!alive || !*alive) return lose_connection();
    if (!unasked) return;
    if (packet.packet.descriptors_lost) {
      // This process had no free descriptor. After a new connection the daemon sends all of it
      // again.
      reannouncement_.lost(Reannouncement::Clock::now());
      if (packet.header().opcode != Opcode::announce) continue;
    }
    handle(packet);
  }
}

/// Asks for a new announcement when shares are free again: endpoints that are mute or not mapped,
/// because there were too many, then get doorbells and are mapped.
void ControlThread::look_for_doorbells() noexcept {
  const auto now = Reannouncement::Clock::now();
  if (reconnection_.state() != Reconnection::State::connected || !reannouncement_.may_look(now))
    return;
  reannouncement_.looked(now);
  const bool has_descriptors = DescriptorShare::instance().has_more();
  if (MappingShare::instance().has_more() || has_descriptors) reannouncement_.ask(now);
}

/// Returns whether this is a previous session that may end by itself.
bool ControlThread::is_former() const noexcept {
  return state_.may_end_by_itself() && &Context::instance() != context_;
}

/// The packets about the connection itself, and about what this process has at the daemon.
struct ControlThread::Handler {
  Opcode opcode;
  void (ControlThread::*handle)(Incoming&);
};

void ControlThread::handle(Incoming& packet) {
  static constexpr Handler handlers[] = {
      {Opcode::rejoined, &ControlThread::on_rejoined},
      {Opcode::refused, &ControlThread::on_refused},
      {Opcode::revoked, &ControlThread::on_revoked},
      {Opcode::own, &ControlThread::on_own},
      {Opcode::region, &ControlThread::on_region},
      {Opcode::doorbells_renewed, &ControlThread::on_doorbells_renewed},
  };
  AGNOCAST_CRASH_POINT(C_packet);
  if (announcements_.handle(registration_.connection(), packet)) return;
  const Opcode opcode = packet.header().opcode;
  for (const Handler& handler : handlers) {
    if (handler.opcode == opcode) return (this->*handler.handle)(packet);
  }
  // A newer daemon may send opcodes that this client does not know.
}

// A place that is between two users stays without new doorbells: its next user looks by itself.
void ControlThread::on_doorbells_renewed(Incoming& packet) {
  wire::DoorbellsRenewed renewed{};
  if (!packet.read(renewed) || packet.packet.descriptor_count != 2) return;
  const auto fds = packet.packet.fds();
  DoorbellReceiver doorbells(std::move(fds[0]), std::move(fds[1]));  // later the previous ones
  for (const auto& wait_set : Reregistration::instance().wait_sets()) {
    if (wait_set->index_in(context_) != renewed.wait_set) continue;
    wait_set->renew(context_, doorbells);
    return;
  }
  places_.renew(renewed.wait_set, doorbells);
}

void ControlThread::run_upkeep() {
  HeapReturn::instance().look();
  if (state_.is_alone()) return run_former_upkeep();
  if (reconnection_.state() == Reconnection::State::connected &&
      state_.step(SessionState::Step::speak)) {
    state_.give_reason(Errc::ok);
    tell_state(ConnectionState::connected);
  }
  look_for_doorbells();
  departures_.say(registration_.connection(), registration_.wake());
  readers_.look(endpoints_, heap_, registration_.connection());
  if (reconnection_.state() == Reconnection::State::connected)
    threads_.tell(registration_.connection());
  collector_.collect(registration_.connection());
  departures_.end_unclaimed(registration_.connection(), registration_.wake(),
                            registration_.board());
  heap_.ask_for_window(registration_.connection(), registration_.region_base());
}

// --- a session whose daemon will not come back: this thread finds out which peers are gone

void ControlThread::run_former_upkeep() {
  collector_.scan();
  const auto now = std::chrono::steady_clock::now();
  if (now - former_looked_ < std::chrono::milliseconds{ScanTimer::alone_ms}) return;
  former_looked_ = now;
  if (&Context::instance() == context_) Reregistration::instance().go_on();
  collector_.collect_alone();
}

// Only wait sets still use the session; this releases their places.
bool ControlThread::unmap_everything() {
  Reregistration::instance().release_places(*context_);
  if (!places_.end()) return false;  // retried in the next cycle
  AGNOCAST_CRASH_POINT(C_previous_end);
  Heap::leave_region(registration_.region_base());
  AGNOCAST_CRASH_POINT(C_previous_end);
  departures_.forget_unclaimed();
  registration_.unmap_all();
  AGNOCAST_CRASH_POINT(C_previous_end);
  epoll_.reset();
  ControlWake::give_back(registration_.wake());
  return true;
}

}  // namespace agnocast
