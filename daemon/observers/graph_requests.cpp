// SPDX-License-Identifier: Apache-2.0

#include <daemon/observers/graph_requests.hpp>

#include <agnocast/abi/limits.hpp>
#include <base/clock.hpp>

#include <algorithm>
#include <utility>

namespace agnocast::daemon {
namespace {

// At once: twice each process that there may be. Then one each millisecond: a packet takes some
// microseconds, so that no user takes a noticeable part of the daemon's time by it.
constexpr std::uint64_t told_at_once = 2 * abi::client_count_max;
constexpr std::uint64_t told_interval_ms = 1;

}  // namespace

Result<void> GraphRequests::watch(Peer& peer, const wire::WatchGraph& request) {
  if (auto opened = table_.open(); !opened) return opened;
  const std::uint64_t now = monotonic_ms();
  table_.update(now);
  if (request.table != table_.number()) {
    answer(peer, request, {table_.reader()});
    return {};
  }
  if (!std::exchange(peer.awaits_graph, request)) waiting_.push_back(peer.id);
  if (request.seen != table_.changes()) tell(peer, now);
  return {};
}

void GraphRequests::answer(Peer& peer, const wire::WatchGraph& request, std::vector<SharedFd> fds) {
  auto packet = make_body<wire::GraphChanged>(wire::Opcode::graph_changed, request.header.request);
  packet.table = table_.number();
  packet.changes = table_.changes();
  output_.reply(peer, packet_of(packet), std::move(fds));
}

Allowance& GraphRequests::allowance_of(std::uint32_t uid) {
  return allowances_.try_emplace(uid, Allowance(told_at_once, told_interval_ms)).first->second;
}

/// Returns the peer while it has a connection.
Peer* GraphRequests::present(PeerId id) const {
  Peer* const peer = connections_.find(id);
  if (peer == nullptr || !peer->session.closed()) return peer;
  peer->awaits_graph.reset();  // it asks again on its next connection
  return nullptr;
}

/// Returns whether the peer waits no longer.
bool GraphRequests::tell(Peer& peer, std::uint64_t now_ms) {
  if (!peer.awaits_graph) return true;
  if (peer.awaits_graph->seen == table_.changes()) return false;
  if (!allowance_of(peer.session.identity().uid).take(now_ms)) return false;
  answer(peer, *std::exchange(peer.awaits_graph, std::nullopt), {});
  return true;
}

void GraphRequests::go_on(std::uint64_t now_ms) {
  if (!table_.is_open()) return;
  table_.update(now_ms);
  if (told_changes_ == table_.changes()) return;
  bool some_wait = false;
  std::erase_if(waiting_, [&](PeerId id) {
    Peer* const peer = present(id);
    if (peer == nullptr) return true;
    const bool is_told = tell(*peer, now_ms);
    some_wait |= !is_told && peer->awaits_graph->seen != table_.changes();
    return is_told;
  });
  if (!some_wait) told_changes_ = table_.changes();
}

int GraphRequests::due_ms(std::uint64_t now_ms) const noexcept {
  if (!table_.is_open() || told_changes_ == table_.changes()) return -1;
  std::uint64_t due = UINT64_MAX;
  for (const auto& [uid, allowance] : allowances_) due = std::min(due, allowance.due_ms(now_ms));
  return due == UINT64_MAX ? 0 : static_cast<int>(std::min<std::uint64_t>(due, 1'000));
}

void GraphRequests::forget_idle(std::uint64_t now_ms) {
  std::erase_if(waiting_, [this](PeerId id) { return present(id) == nullptr; });
  std::erase_if(allowances_, [&](const auto& one) { return one.second.is_whole(now_ms); });
}

}  // namespace agnocast::daemon
