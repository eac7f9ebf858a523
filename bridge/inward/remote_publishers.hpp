// SPDX-License-Identifier: Apache-2.0
//
// Remote publishers: the remote publishers, each a publisher on this host in place of a remote
// writer, and their costs. A message that keep-all blocks (a subscription of this host has not read
// enough) waits here, within bounds; nothing signals room, so it is tried again at intervals
// (retry_interval.hpp). The histories of transient-local publishers are bounded, for each and for
// all of them.
//
// One thread, run()'s.
#pragma once

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <bridge/common/linger.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/slow_deleter.hpp>
#include <bridge/common/traffic.hpp>
#include <bridge/dds/limits.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/inward/reader_handover.hpp>
#include <bridge/plan/routes.hpp>

#include <chrono>
#include <cstddef>
#include <deque>
#include <map>
#include <optional>
#include <set>

namespace agnocast::bridge {

/// The object that a decoder gives to take(): the reader owns it, its message is in shared memory.
struct Received {
  OwnedGenericMessage message;
  std::size_t bytes = 0;
};

/// The publisher in place of one remote writer.
struct OpenRemotePublisher {
  RemotePublisherPlan plan;
  GenericPublisher::SharedPtr publisher;
  Traffic traffic;
  std::deque<Received> waiting;     // keep-all only
  std::optional<Time> end;          // not planned any more; ends then, or when nothing waits
                                    // any longer, after held_linger at the latest
  std::size_t depth = 1;            // of the publisher; less than planned after a Limit
  std::deque<std::size_t> history;  // if transient-local: bytes of each retained message
  std::size_t history_bytes = 0;
  ReaderHandover handover;
};

class RemotePublishers {
 public:
  /// All must outlive it. `types` knows every planned type; `deleter` ends publishers.
  RemotePublishers(Node& node, const MessageTypes& types, Limits& limits, SlowDeleter& deleter,
                   const Log& log)
      : node_(node), types_(types), limits_(limits), deleter_(deleter), log_(log) {}

  /// Creates the publisher for a writer that has none.
  Result<OpenRemotePublisher*> open(const Guid& writer, const RemotePublisherPlan& plan);
  /// Publishes the message, keeps it waiting, or drops it.
  void publish(const Guid& writer, OpenRemotePublisher& remote_publisher, Received& received);
  /// Tries waiting messages when due. Returns when to call it again; nothing if none waits.
  std::optional<Time> publish_waiting(Time now);
  /// Ends publishers that are due. Returns when to call it again.
  std::optional<Time> tidy(Time now);
  /// Ends everything at once, with the waiting messages.
  void clear();

  /// Keyed by remote writer.
  std::map<Guid, OpenRemotePublisher>& all() noexcept { return open_; }
  const std::map<Guid, OpenRemotePublisher>& all() const noexcept { return open_; }

 private:
  Result<GenericPublisher::SharedPtr> make_publisher(const RemotePublisherPlan& plan,
                                                     std::size_t depth) const;
  /// Makes room in the histories for a message of this publisher. Returns false if there is none.
  bool fit_history(OpenRemotePublisher& remote_publisher, std::size_t bytes);
  void forget_history(OpenRemotePublisher& remote_publisher);
  /// Returns false if keep-all blocks it; then `received` still has it.
  bool publish_now(OpenRemotePublisher& remote_publisher, Received& received);
  /// Returns whether a waiting message was published.
  bool publish_held();
  void drop(OpenRemotePublisher& remote_publisher, const char* why, std::size_t messages = 1) const;
  void drop_waiting(const Guid& writer, OpenRemotePublisher& remote_publisher);

  Node& node_;
  const MessageTypes& types_;
  Limits& limits_;
  SlowDeleter& deleter_;
  const Log& log_;
  std::map<Guid, OpenRemotePublisher> open_;
  std::size_t history_bytes_ = 0;  // of all publishers
  std::set<Guid> held_;            // writers with waiting messages
  std::size_t held_bytes_ = 0;
  Time next_room_look_;  // when to try held_ again
  std::chrono::nanoseconds retry_interval_{0};
};

}  // namespace agnocast::bridge
