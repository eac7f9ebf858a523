// SPDX-License-Identifier: Apache-2.0
//
// ObserverAnswers: long answers to observers: dumps, the journal.
//
// A small request asks for much work, so each user has an allowance of answers; a request beyond
// it waits, and the answer has the facts of its own time. An answer is made at once; the observer
// reads it at its own pace, within the daemon's patience.
#pragma once

#include <daemon/config/config.hpp>
#include <daemon/death/client_termination.hpp>
#include <daemon/observers/dump.hpp>
#include <daemon/observers/dump_collector.hpp>
#include <daemon/state/registry.hpp>
#include <daemon/transport/allowance.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/peer_output.hpp>

#include <cstdint>
#include <deque>
#include <unordered_map>
#include <vector>

namespace agnocast::daemon {

class ObserverAnswers {
 public:
  ObserverAnswers(const Config::Quota& quota, const Registry& registry,
                  const DumpCollector& collector, ConnectionTable& connections, PeerOutput& output,
                  ClientTermination& termination) noexcept
      : quota_(quota),
        registry_(registry),
        collector_(collector),
        connections_(connections),
        output_(output),
        termination_(termination) {}

  /// Queues a request; go_on() answers it.
  void ask(Peer& peer, const LongRequest& request);
  /// Answers all observers whose user has an allowance left.
  void go_on();
  /// Returns after how many ms go_on() is to be called; -1: no request waits.
  int due_ms() const noexcept;
  void drop_slow(std::uint64_t now);
  void forget_idle_users(std::uint64_t now);

 private:
  /// One user's state; outlives its connections.
  struct Answers {
    Allowance allowance;
    std::deque<PeerId> waiting;
  };
  void answer(Peer& peer, const LongRequest& request);
  void send(Peer& peer, std::vector<Outgoing> packets);
  DumpFacts facts() const;

  const Config::Quota& quota_;
  const Registry& registry_;
  const DumpCollector& collector_;
  ConnectionTable& connections_;
  PeerOutput& output_;
  ClientTermination& termination_;
  std::unordered_map<std::uint32_t, Answers> answers_;  // by uid
};

}  // namespace agnocast::daemon
