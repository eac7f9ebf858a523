// SPDX-License-Identifier: Apache-2.0

#include <daemon/observers/graph_requests.hpp>

#include <agnocast/abi/limits.hpp>
#include <base/clock.hpp>
#include <daemon/state/memory_reserve.hpp>

#include <algorithm>
#include <utility>

namespace agnocast::daemon {
namespace {

// At once: twice each process that there may be. Then one each millisecond: a packet takes some
// microseconds, so that no user takes a noticeable part of the daemon's time by it.
constexpr std::uint64_t notified_at_once = 2 * abi::client_count_max;
constexpr std::uint64_t told_interval_ms = 1;

}  // namespace

Result<void> GraphRequests::watch(Peer& peer, const wire::WatchGraph& request) {
  if (auto opened = table_.open(); !opened) return opened;
  MemoryReserve::no_return();
  const std::uint64_t now = monotonic_ms();
  table_.update(now);
  if (request.table != table_.number()) {
    peer.awaits_graph.reset();
    answer(peer, request, {table_.reader()});
    return {};
  }
  peer.awaits_graph = request;
  if (notify(peer, now)) return {};
  if (request.seen != table_.changes()) {
    is_late_ = true;
    late_until_ms_ = 0;
  }
  if (peer.is_listed) return {};
  waiting_.push_back(peer.id);
  peer.is_listed = true;
  return {};
}

void GraphRequests::answer(Peer& peer, const wire::WatchGraph& request, std::vector<SharedFd> fds) {
  auto packet = make_body<wire::GraphChanged>(wire::Opcode::graph_changed, request.header.request);
  packet.table = table_.number();
  packet.changes = table_.changes();
  output_.reply(peer, packet_of(packet), std::move(fds));
}

Allowance& GraphRequests::allowance_of(std::uint32_t uid) {
  return allowances_.try_emplace(uid, Allowance(notified_at_once, told_interval_ms)).first->second;
}

/// Returns whether the peer still waits; one without a connection asks again on its next one.
bool GraphRequests::waits(Peer* peer) noexcept {
  if (peer == nullptr) return false;
  if (peer->session.closed() || peer->revoked) peer->awaits_graph.reset();
  if (!peer->awaits_graph) peer->is_listed = false;
  return peer->is_listed;
}

/// Returns whether the peer was notified: it waits no longer.
bool GraphRequests::notify(Peer& peer, std::uint64_t now_ms) {
  if (peer.awaits_graph->seen == table_.changes()) return false;
  if (!allowance_of(peer.session.identity().uid).take(now_ms)) return false;
  answer(peer, *std::exchange(peer.awaits_graph, std::nullopt), {});
  return true;
}

void GraphRequests::go_on(std::uint64_t now_ms) {
  if (!table_.is_open()) return;
  table_.update(now_ms);
  if (told_changes_ == table_.changes() && !is_late_) return;
  told_changes_ = table_.changes();
  late_until_ms_ = UINT64_MAX;
  std::erase_if(waiting_, [&](PeerId id) {
    Peer* const peer = connections_.find(id);
    if (!waits(peer)) return true;
    if (notify(*peer, now_ms)) return !waits(peer);
    if (peer->awaits_graph->seen != told_changes_) {
      const Allowance& allowance = allowance_of(peer->session.identity().uid);
      late_until_ms_ = std::min(late_until_ms_, now_ms + allowance.due_ms(now_ms));
    }
    return false;
  });
  is_late_ = late_until_ms_ != UINT64_MAX;
}

int GraphRequests::due_ms(std::uint64_t now_ms) const noexcept {
  if (!table_.is_open()) return -1;
  if (told_changes_ != table_.changes()) return 0;
  if (!is_late_) return -1;
  const std::uint64_t left = std::max(late_until_ms_, now_ms) - now_ms;
  return static_cast<int>(std::min<std::uint64_t>(left, 1'000));
}

void GraphRequests::forget_idle(std::uint64_t now_ms) {
  std::erase_if(waiting_, [this](PeerId id) { return !waits(connections_.find(id)); });
  std::erase_if(allowances_, [&](const auto& one) { return one.second.is_whole(now_ms); });
}

}  // namespace agnocast::daemon
