// SPDX-License-Identifier: Apache-2.0
//
// GraphRequests: processes that watch the graph. Each asks for the graph table once, and then to be
// notified of the next change; the packet says only that there is one. So a process that
// does not ask again costs nothing more, and many changes cost one packet.
//
// A change of one endpoint concerns every process that watches, so a user with many of them has an
// allowance of such packets; beyond it they wait, and changes meanwhile are reported together.
#pragma once

#include <base/clock.hpp>
#include <daemon/observers/graph_table.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/allowance.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/peer_output.hpp>

#include <cstdint>
#include <unordered_map>
#include <vector>

namespace agnocast::daemon {

class GraphRequests {
 public:
  GraphRequests(Registry& registry, ConnectionTable& connections, PeerOutput& output) noexcept
      : table_(registry), connections_(connections), output_(output) {}

  /// Errors: os_failure (the table cannot be made).
  [[nodiscard]] Result<void> watch(Peer& peer, const wire::WatchGraph& request);
  /// Brings the table up to date: a process that is notified of a change finds it there.
  void write() { table_.update(monotonic_ms()); }
  /// Does so as well, and tells those who wait for that.
  void go_on(std::uint64_t now_ms);
  /// Returns after how many ms go_on() is to be called; -1: nobody is notified late.
  int due_ms(std::uint64_t now_ms) const noexcept;
  void forget_idle(std::uint64_t now_ms);

 private:
  static bool waits(Peer* peer) noexcept;
  bool notify(Peer& peer, std::uint64_t now_ms);
  void answer(Peer& peer, const wire::WatchGraph& request, std::vector<SharedFd> fds);
  Allowance& allowance_of(std::uint32_t uid);

  GraphTable table_;
  ConnectionTable& connections_;
  PeerOutput& output_;
  std::vector<PeerId> waiting_;
  std::uint64_t told_changes_ = 0;   // all that wait were looked at since this change
  bool is_late_ = false;             // some of them could not be notified of it yet
  std::uint64_t late_until_ms_ = 0;  // the first of these can be then
  std::unordered_map<std::uint32_t, Allowance> allowances_;  // by uid
};

}  // namespace agnocast::daemon
