// SPDX-License-Identifier: Apache-2.0

#include <daemon/process/refuser.hpp>

#include <base/clock.hpp>
#include <base/sockets/peer_identity.hpp>
#include <daemon/transport/client_channel.hpp>

#include <sys/epoll.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <utility>

namespace agnocast::daemon {
namespace {

// Connections that send nothing must not take the descriptors of those that do.
constexpr std::size_t caller_count_max = 64;
// A process that connects again and again would never let it end; signals must not wait for that.
constexpr unsigned connections_per_slice = 8;
// How long no connection is accepted when no descriptor is left.
constexpr std::uint64_t pause_ms = 100;

}  // namespace

Refuser::~Refuser() {
  dispatcher_.remove(listening_);
  for (auto& [id, caller] : callers_) {
    dispatcher_.remove(caller.token);
    // The end of the process closes the socket without lingering.
    static_cast<void>(caller.socket.release().release());
  }
}

Result<void> Refuser::start() {
  const auto token =
      dispatcher_.add(listener_.fd(), EPOLLIN, [this](std::uint32_t) { accept_all(); });
  if (!token) return tl::unexpected(token.error());
  listening_ = *token;
  return {};
}

int Refuser::due_ms() const noexcept {
  if (!listens_again_ms_) return -1;
  const std::uint64_t now = monotonic_ms();
  return static_cast<int>(*listens_again_ms_ - std::min(*listens_again_ms_, now));
}

void Refuser::tick() {
  if (!listens_again_ms_ || monotonic_ms() < *listens_again_ms_) return;
  listens_again_ms_.reset();
  dispatcher_.change(listening_, EPOLLIN);
}

void Refuser::accept_all() {
  for (unsigned round = 0; round < connections_per_slice; ++round) {
    auto socket = listener_.accept();
    if (!socket) {
      // No descriptor was left, and the dispatcher reports waiting connections again and again.
      if (!callers_.empty()) drop(callers_.begin());
      dispatcher_.change(listening_, 0);
      listens_again_ms_ = monotonic_ms() + pause_ms;
      return;
    }
    if (!*socket) return;
    const std::uint64_t id = ++last_caller_;
    const auto token =
        dispatcher_.add((*socket)->fd(), EPOLLIN, [this, id](std::uint32_t) { answer(id); });
    const std::uint32_t uid = uid_of((*socket)->fd());
    if (!token) {
      disposal_.close_connection(uid, (*socket)->release());
      continue;
    }
    callers_.emplace(id, Caller{std::move(**socket), *token, uid});
    if (callers_.size() > caller_count_max) drop(callers_.begin());
  }
}

void Refuser::answer(std::uint64_t id) {
  const auto found = callers_.find(id);
  if (found == callers_.end()) return;
  std::array<std::byte, wire::packet_bytes_max> buffer;
  // A packet with descriptors is not received and goes with the connection.
  if (const auto next = found->second.socket.peek(buffer); next && next->has_descriptors)
    return drop(found);
  const auto packet = found->second.socket.receive(buffer);
  if (packet && packet->kind == Packet::Kind::nothing) return;
  if (packet && packet->kind == Packet::Kind::data) {
    wire::Header header{};
    if (packet->bytes >= sizeof header)
      std::memcpy(static_cast<void*>(&header), buffer.data(), sizeof header);
    auto refused =
        make_body<wire::Refused>(wire::Opcode::refused, header.request & ~wire::asked_again);
    // A process that rejoins has a stored session and must try again: a refusal would orphan it.
    const Errc code = header.opcode == wire::Opcode::rejoin ? Errc::daemon_not_running : code_;
    refused.code = static_cast<std::uint32_t>(code);
    refused.text = name_of(why_);
    const auto sent = found->second.socket.send(packet_of(refused));
    log_.write_limited("refused", LogLevel::warning, "request refused",
                       {{"code", word_of(code)}, {"why", why_}});
    if (sent && *sent == Sent::sent) return;
  }
  drop(found);
}

void Refuser::drop(Callers::iterator caller) {
  dispatcher_.remove(caller->second.token);
  disposal_.close_connection(caller->second.uid, caller->second.socket.release());
  callers_.erase(caller);
}

}  // namespace agnocast::daemon
