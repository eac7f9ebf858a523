// SPDX-License-Identifier: Apache-2.0

#include <base/descriptors/closing.hpp>
#include <base/signals.hpp>

#include <fcntl.h>
#include <linux/close_range.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <exception>
#include <functional>
#include <memory>
#include <new>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

// Intervals of polling for the end of a thread, which nearly always comes at once, and never if
// it is stuck.
constexpr std::chrono::microseconds first_pause{50}, last_pause{100'000};

/// Steps that two threads wait for.
class Stages {
 public:
  enum Stage : int { begun, taken, given, done };
  void go_to(Stage next) noexcept {
    stage_.store(next, std::memory_order_release);
    stage_.notify_all();
  }
  void wait_for(Stage wanted) const noexcept {
    for (int now = stage_.load(std::memory_order_acquire); now < wanted;
         now = stage_.load(std::memory_order_acquire))
      stage_.wait(now, std::memory_order_acquire);
  }
  bool has_come_to(Stage wanted) const noexcept {
    return stage_.load(std::memory_order_acquire) >= wanted;
  }

 private:
  std::atomic<int> stage_{begun};
};

/// State shared by the ending thread and its creator.
struct Handover {
  std::span<const UniqueFd> fds;
  const std::function<void(int)>* work = nullptr;  // called with the number of the first one
  Stages stages;
  std::size_t taken_count = 0;
  EndingThread thread;
};

// Gives this thread an empty descriptor table. Returns a pidfd of this process, whose other
// threads keep the old table.
int leave_table() noexcept {
  if (::syscall(SYS_close_range, 0U, ~0U, CLOSE_RANGE_UNSHARE) != 0) return -1;
  return static_cast<int>(::syscall(SYS_pidfd_open, ::getpid(), 0U));
}

void take_over_and_end(Handover& handover) noexcept {
  handover.thread.id = static_cast<pid_t>(::syscall(SYS_gettid));
  const int process = leave_table();
  // The numbers of an empty table are consecutive.
  const int first = process + 1;
  std::size_t taken = 0;
  while (process >= 0 && taken < handover.fds.size() &&
         ::syscall(SYS_pidfd_getfd, process, handover.fds[taken].get(), 0U) >= 0)
    ++taken;
  if (taken < handover.fds.size()) handover.thread.error = errno;
  handover.taken_count = taken;
  handover.stages.go_to(Stages::taken);
  handover.stages.wait_for(Stages::given);
  if (handover.work != nullptr && handover.thread.error == 0) (*handover.work)(first);
}

EndingThread hand_over(std::span<UniqueFd> fds,
                       const std::function<void(int)>* work = nullptr) noexcept {
  Handover handover;
  handover.fds = fds;
  handover.work = work;
  try {
    const SignalsBlocked blocked;
    std::thread thread([&] { take_over_and_end(handover); });
    handover.stages.wait_for(Stages::taken);
    // These are not the last references, so the closes only release the numbers.
    for (UniqueFd& fd : fds.first(handover.taken_count)) fd.reset();
    handover.stages.go_to(Stages::given);
    thread.join();                   // does not wait for the kernel's work at its end
  } catch (const std::exception&) {  // no thread left, or no memory for one
    handover.thread.error = EAGAIN;
  }
  return handover.thread;
}

// Threads that have discarded a datagram and may be stuck at their end. So many doorbells of a
// process can contain a descriptor whose close never returns.
std::array<std::atomic<pid_t>, 8> emptying{};

std::atomic<pid_t>* free_place() noexcept {
  for (std::atomic<pid_t>& place : emptying) {
    pid_t thread = place.load(std::memory_order_relaxed);
    if (thread != 0 && (thread < 0 || !has_ended(thread))) continue;
    if (place.compare_exchange_strong(thread, -1, std::memory_order_relaxed)) return &place;
  }
  return nullptr;
}

/// State shared by a thread that discards a datagram and its creator, which does not wait for it.
struct Emptied {
  Stages stages;
  bool has_socket = false;
};

// Has room for all descriptors, so the kernel closes none in between. `socket` is a number of the
// caller's table, which may be reused as soon as the caller continues.
void receive_one_and_end(int socket, std::atomic<pid_t>& place, Emptied& emptied) noexcept {
  constexpr std::size_t descriptors_per_packet = 253;  // SCM_MAX_FD
  const int process = leave_table();
  const auto doorbell =
      process < 0 ? -1 : static_cast<int>(::syscall(SYS_pidfd_getfd, process, socket, 0U));
  emptied.has_socket = doorbell >= 0;
  emptied.stages.go_to(Stages::taken);
  alignas(cmsghdr) std::byte control[CMSG_SPACE(sizeof(int) * descriptors_per_packet)];
  msghdr message{};
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  if (doorbell >= 0 && ::recvmsg(doorbell, &message, MSG_DONTWAIT) >= 0)
    emptied.stages.go_to(Stages::done);
  place.store(static_cast<pid_t>(::syscall(SYS_gettid)), std::memory_order_relaxed);
}

// Only shared memory has seals.
bool is_shared_memory(int fd) noexcept { return ::fcntl(fd, F_GET_SEALS) >= 0; }

// Returns the received memory, if it is the only descriptor. Descriptors beyond the packet's
// places go to `more`.
UniqueFd* receive_into(ReceivedMemory& received, const PacketSocket& connection,
                       std::span<std::byte> buffer, std::vector<UniqueFd>& more) noexcept {
  try {
    received.packet = connection.receive_all(buffer, more);
  } catch (const std::bad_alloc&) {
    received.packet = fail(Errc::os_failure, "receiving a packet", ENOMEM);
  }
  if (!received.packet) return nullptr;
  const std::span<UniqueFd> fds = received.packet->fds();
  received.descriptor_count = fds.size() + more.size();
  return received.descriptor_count == 1 && is_shared_memory(fds[0].get()) ? fds.data() : nullptr;
}

// Runs in the ending thread, which closes nothing before its end. `first`: number of the
// connection; the next number is the socket back to the caller.
void receive_and_end(ReceivedMemory& received, std::span<std::byte> buffer, int first) noexcept {
  PacketSocket connection{UniqueFd(first)}, way_back{UniqueFd(first + 1)};
  std::vector<UniqueFd> more;
  Result<Sent> sent = Sent::sent;
  if (const UniqueFd* const memory = receive_into(received, connection, buffer, more)) {
    const std::byte word{};
    const std::array<int, 1> fds{memory->get()};
    sent = way_back.send({&word, 1}, fds);
  }
  if (received.packet) {
    for (UniqueFd& fd : received.packet->fds()) static_cast<void>(fd.release());
  }
  for (UniqueFd& fd : more) static_cast<void>(fd.release());
  static_cast<void>(connection.release().release());
  static_cast<void>(way_back.release().release());
  if (!sent) received.packet = tl::unexpected(sent.error());
}

void receive_here(ReceivedMemory& received, const PacketSocket& connection,
                  std::span<std::byte> buffer) noexcept {
  std::vector<UniqueFd> more;
  if (UniqueFd* const memory = receive_into(received, connection, buffer, more))
    received.memory = std::move(*memory);
  if (received.packet) close_received(received.packet->fds());
  close_received(more);
}

}  // namespace

bool EndingThread::is_forbidden() const noexcept { return error == EPERM || error == ENOSYS; }

bool has_ended(pid_t thread) noexcept { return ::syscall(SYS_tgkill, ::getpid(), thread, 0) != 0; }

EndingThread close_at_end_of_thread(std::span<UniqueFd> fds) noexcept { return hand_over(fds); }

void close_by_ending_thread(std::span<UniqueFd> fds) noexcept {
  const EndingThread thread = hand_over(fds);
  if (thread.id != 0) {
    for (auto pause = first_pause; !has_ended(thread.id); pause = std::min(pause * 2, last_pause))
      std::this_thread::sleep_for(pause);
  }
  for (UniqueFd& fd : fds) fd.reset();  // those that the thread could not take over
}

void use_in_own_table(int fd, const std::function<void(int)>& work) noexcept {
  bool is_done = false;
  try {
    const SignalsBlocked blocked;
    std::thread([&] {
      const int process = leave_table();
      const auto own =
          process < 0 ? -1 : static_cast<int>(::syscall(SYS_pidfd_getfd, process, fd, 0U));
      if (own < 0) return;
      work(own);
      is_done = true;
    }).join();
  } catch (const std::exception&) {  // no thread left, or no memory for one
  }
  if (!is_done) work(fd);
}

void close_received(std::span<UniqueFd> fds) noexcept {
  const linger none{};
  for (UniqueFd& fd : fds) {
    ::setsockopt(fd.get(), SOL_SOCKET, SO_LINGER, &none, sizeof none);  // fails for non-sockets
    fd.reset();
  }
}

ReceivedMemory receive_memory(PacketSocket connection, std::span<std::byte> buffer) noexcept {
  ReceivedMemory received;
  auto ends = PacketSocket::pair();
  EndingThread thread;
  std::array<UniqueFd, 2> fds{connection.release()};
  if (ends) {
    fds[1] = ends->second.release();
    const std::function<void(int)> work = [&](int first) {
      receive_and_end(received, buffer, first);
    };
    thread = hand_over(fds, &work);
    if (thread.error != 0)
      received.packet = fail(Errc::os_failure, "receiving in another thread", thread.error);
  } else {
    received.packet = tl::unexpected(ends.error());
  }
  received.thread = thread.id;
  if (fds[0] && thread.is_forbidden()) {
    connection = PacketSocket(std::move(fds[0]));
    receive_here(received, connection, buffer);
    fds[0] = connection.release();
    close_received(fds);
  } else if (fds[0]) {
    close_without_waiting(std::move(fds[0]));
  } else if (received.packet) {
    std::array<std::byte, 1> word;
    auto came = ends->first.receive(word);
    if (came && came->descriptor_count == 1) received.memory = std::move(came->fds()[0]);
  }
  return received;
}

void close_without_waiting(UniqueFd fd) noexcept {
  if (!fd) return;
  hand_over({&fd, 1});
  if (!fd) return;
  try {
    const SignalsBlocked blocked;
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
    const auto emptied = std::make_shared<Emptied>();
    std::thread([socket, place, emptied] {
      receive_one_and_end(socket, *place, *emptied);
    }).detach();
    emptied->stages.wait_for(Stages::taken);  // short: it makes two system calls
    if (!emptied->has_socket) return false;
    for (auto waited = step; !emptied->stages.has_come_to(Stages::done); waited += step) {
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
