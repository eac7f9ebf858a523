// SPDX-License-Identifier: Apache-2.0
//
// PeerOutput: sends packets to processes, and ends connections of processes that do not read.
//
// A packet is sent at once, or waits in the queue of its session. The output of a connection ends
// when its queue is too long, too old, or the longest one of a user with too much queued
// altogether. Then the connection is shut down, not closed: the caller may be in the middle of an
// announcement, and the loop reads the end of the connection later like any other.
#pragma once

#include <base/text/log.hpp>
#include <daemon/transport/client_channel.hpp>
#include <daemon/transport/connection_table.hpp>
#include <daemon/transport/dispatcher.hpp>

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::daemon {

/// [quota] queued_bytes and queued_seconds.
struct OutputLimits {
  std::uint64_t bytes_of_user = 0;
  std::optional<std::uint64_t> seconds;
};

class PeerOutput final : public ClientChannel {
 public:
  PeerOutput(const OutputLimits& limits, ConnectionTable& connections, Dispatcher& dispatcher,
             Log& log) noexcept
      : limits_(limits), connections_(connections), dispatcher_(dispatcher), log_(log) {}

  /// Runs ahead of each attempt to send: what a packet tells of is true by then elsewhere, too. It
  /// has the memory reserve, and sends nothing.
  void set_before_flush(std::function<void()> run) { before_flush_ = std::move(run); }
  void reply(Peer& peer, Outgoing packet);
  void reply(Peer& peer, std::span<const std::byte> packet, std::vector<SharedFd> fds = {});
  /// Sends what the socket accepts.
  void flush(Peer& peer);
  /// Returns whether go_on_flushing() is to be called soon: too many descriptors were in flight.
  bool flushes_later() const noexcept { return flush_later_; }
  void go_on_flushing();
  /// Sends nothing more to it; the loop reads its end like any other.
  void end(Peer& peer, std::string_view why);
  /// Ends the output of this user's connection with the longest queue: it reads least.
  void end_longest(std::uint32_t uid);
  /// Ends the output of every connection that has not read for longer than the limit.
  void end_old(std::uint64_t now);

  // ClientChannel
  Session* session_of(ClientIndex client) override;
  std::uint64_t user_namespace_of(ClientIndex client) override;
  using ClientChannel::send;
  void send(ClientIndex client, Outgoing packet) override;
  void begin_anew(ClientIndex client, std::string_view why) override;

 private:
  OutputLimits limits_;
  ConnectionTable& connections_;
  Dispatcher& dispatcher_;
  Log& log_;
  std::function<void()> before_flush_;
  bool flush_later_ = false;
};

}  // namespace agnocast::daemon
