// SPDX-License-Identifier: Apache-2.0

#include <base/closing.hpp>
#include <base/signals.hpp>

#include <linux/close_range.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <exception>
#include <memory>
#include <thread>

namespace agnocast {
namespace {

// How often the end of a thread is looked for: at once nearly always, and for ever if it is stuck.
constexpr std::chrono::microseconds first_pause{50}, last_pause{100'000};

/// What the ending thread and the one that begins it say to each other.
struct Handover {
  enum Stage : int { begun, taken, given };
  std::span<const UniqueFd> fds;
  std::atomic<int> stage{begun};
  std::size_t taken_count = 0;
  pid_t thread = 0;

  void go_to(Stage next) {
    stage.store(next, std::memory_order_release);
    stage.notify_all();
  }
  void wait_for(Stage wanted) const {
    for (int now = stage.load(std::memory_order_acquire); now < wanted;
         now = stage.load(std::memory_order_acquire))
      stage.wait(now, std::memory_order_acquire);
  }
};

// A table without anything in it; then this very process, whose other threads have the former one.
int leave_table() noexcept {
  if (::syscall(SYS_close_range, 0U, ~0U, CLOSE_RANGE_UNSHARE) != 0) return -1;
  return static_cast<int>(::syscall(SYS_pidfd_open, ::getpid(), 0U));
}

void take_over_and_end(Handover& handover) noexcept {
  handover.thread = static_cast<pid_t>(::syscall(SYS_gettid));
  const int process = leave_table();
  std::size_t taken = 0;
  while (process >= 0 && taken < handover.fds.size() &&
         ::syscall(SYS_pidfd_getfd, process, handover.fds[taken].get(), 0U) >= 0)
    ++taken;
  handover.taken_count = taken;
  handover.go_to(Handover::taken);
  handover.wait_for(Handover::given);
}

bool has_ended(pid_t thread) noexcept {
  return ::syscall(SYS_tgkill, ::getpid(), thread, 0) != 0;
}

// Threads that have thrown a datagram away and may be stuck at their end. As many bells of a process can be
// poisoned with something that does not let go.
std::array<std::atomic<pid_t>, 8> emptying{};

std::atomic<pid_t>* free_place() noexcept {
  for (std::atomic<pid_t>& place : emptying) {
    pid_t thread = place.load(std::memory_order_relaxed);
    if (thread != 0 && (thread < 0 || !has_ended(thread))) continue;
    if (place.compare_exchange_strong(thread, -1, std::memory_order_relaxed)) return &place;
  }
  return nullptr;
}

// With room for all, so that the kernel closes nothing on the way.
void receive_one_and_end(int socket, std::atomic<pid_t>& place,
                         const std::shared_ptr<std::atomic<bool>>& done) noexcept {
  constexpr std::size_t descriptors_per_packet = 253;  // SCM_MAX_FD
  const int process = leave_table();
  const auto bell =
      process < 0 ? -1 : static_cast<int>(::syscall(SYS_pidfd_getfd, process, socket, 0U));
  alignas(cmsghdr) std::byte control[CMSG_SPACE(sizeof(int) * descriptors_per_packet)];
  msghdr message{};
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  const bool taken = bell >= 0 && ::recvmsg(bell, &message, MSG_DONTWAIT) >= 0;
  if (taken) done->store(true, std::memory_order_release);
  place.store(static_cast<pid_t>(::syscall(SYS_gettid)), std::memory_order_relaxed);
}

}  // namespace

void close_by_ending_thread(std::span<UniqueFd> fds) noexcept {
  Handover handover{fds};
  try {
    const SignalsBlocked blocked;
    std::thread thread([&] { take_over_and_end(handover); });
    handover.wait_for(Handover::taken);
    // Not the last ones: these closes do nothing but give the numbers back.
    for (UniqueFd& fd : fds.first(handover.taken_count)) fd.reset();
    handover.go_to(Handover::given);
    thread.join();  // which says nothing of what the kernel still does for it
  } catch (const std::exception&) {  // no thread left, or no memory for one
  }
  if (handover.thread != 0) {
    for (auto pause = first_pause; !has_ended(handover.thread);
         pause = std::min(pause * 2, last_pause))
      std::this_thread::sleep_for(pause);
  }
  for (UniqueFd& fd : fds) fd.reset();  // what could not be taken over
}

void close_received(std::span<UniqueFd> fds) noexcept {
  const linger none{};
  for (UniqueFd& fd : fds) {
    ::setsockopt(fd.get(), SOL_SOCKET, SO_LINGER, &none, sizeof none);  // others refuse it
    fd.reset();
  }
}

void close_without_waiting(UniqueFd fd) noexcept {
  if (!fd) return;
  try {
    const SignalsBlocked blocked;
    const auto handover = std::make_shared<Handover>();
    handover->fds = {&fd, 1};
    std::thread([handover] { take_over_and_end(*handover); }).detach();
    handover->wait_for(Handover::taken);
    const bool taken = handover->taken_count == 1;
    if (taken) fd.reset();
    handover->go_to(Handover::given);
    if (taken) return;
    std::thread([number = fd.get()] { ::close(number); }).detach();
  } catch (const std::exception&) {  // no thread left, or no memory for one: it stays open
  }
  static_cast<void>(fd.release());
}

bool throw_datagram_away(int socket) noexcept {
  constexpr std::chrono::microseconds patience{50'000}, step{50};
  std::atomic<pid_t>* const place = free_place();
  if (place == nullptr) return false;
  try {
    const SignalsBlocked blocked;
    const auto done = std::make_shared<std::atomic<bool>>(false);
    std::thread([socket, place, done] { receive_one_and_end(socket, *place, done); }).detach();
    for (auto waited = step; !done->load(std::memory_order_acquire); waited += step) {
      if (waited > patience) return false;
      std::this_thread::sleep_for(step);
    }
    return true;
  } catch (const std::exception&) {
    place->store(0, std::memory_order_relaxed);
    return false;
  }
}

}  // namespace agnocast
