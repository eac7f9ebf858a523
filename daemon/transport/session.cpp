// SPDX-License-Identifier: Apache-2.0

#include <daemon/transport/session.hpp>

#include <algorithm>
#include <array>
#include <cerrno>
#include <utility>

namespace agnocast::daemon {

std::uint64_t Session::push(std::span<const std::byte> bytes, std::vector<SharedFd> fds) {
  push(Outgoing{{bytes.begin(), bytes.end()}, std::move(fds), {}});
  return packet_count_;
}

void Session::push(Outgoing packet) {
  // Approximate: includes the overhead of malloc and the function.
  packet.cost_bytes =
      sizeof packet + packet.bytes.size() + packet.fds.size() * sizeof(SharedFd) + 128;
  queue_.push_back(std::move(packet));
  queued_.set(queued_.own() + queue_.back().cost_bytes);
  KeptForUser& user = queued_.user();
  user.peak = std::max(user.peak, user.bytes);
  ++packet_count_;
}

Session::Flushed Session::flush() {
  Flushed result = Flushed::all;
  held_back_ = false;
  while (!queue_.empty() && result == Flushed::all) {
    Outgoing& packet = queue_.front();
    if (const auto complete = std::exchange(packet.complete, nullptr)) complete(packet);
    std::array<int, abi::wire::descriptor_count_max> fds{};
    std::size_t count = 0;
    for (const SharedFd& fd : packet.fds) fds[count++] = fd->get();
    const auto sent = socket_.send(packet.bytes, {fds.data(), count});
    if (!sent) {
      if (sent.error().os_errno != ETOOMANYREFS) return Flushed::over;
      result = Flushed::later;
      held_back_ = true;
    } else if (*sent == Sent::peer_gone) {
      return Flushed::gone;
    } else if (*sent == Sent::would_block) {
      result = Flushed::blocked;
    } else {
      queued_.set(queued_.own() - packet.cost_bytes);
      queue_.pop_front();
    }
  }
  return queue_.size() <= queue_count_max || observing_ ? result : Flushed::over;
}

}  // namespace agnocast::daemon
