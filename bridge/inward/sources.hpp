// SPDX-License-Identifier: Apache-2.0
//
// Sources: the publishers in the place of remote writers, and what they may cost. A message that keep-all holds up (a
// subscription of this host has not read enough) waits here for its turn, within bounds; nobody tells when there is room
// for it, so what waits is tried again by and by (room.hpp). What transient-local publishers retain is bounded for each
// and for all of them.
//
// One thread, run()'s.
#pragma once

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <bridge/common/linger.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/message_types.hpp>
#include <bridge/common/reaper.hpp>
#include <bridge/common/traffic.hpp>
#include <bridge/dds/limits.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/inward/way.hpp>
#include <bridge/plan/routes.hpp>

#include <chrono>
#include <cstddef>
#include <deque>
#include <map>
#include <optional>
#include <set>

namespace agnocast::bridge {

/// What a decoder hands to take(): the object is the reader's, its message is shared memory.
struct Received {
  OwnedGenericMessage message;
  std::size_t bytes = 0;
};

/// The publisher in the place of one remote writer.
struct OpenSource {
  Source plan;
  GenericPublisher::SharedPtr publisher;
  Traffic traffic;
  std::deque<Received> waiting;     // keep-all only
  std::optional<Time> end;          // not planned any more; ends then, or when nothing waits
                                    // any longer, after held_linger at the latest
  std::size_t depth = 1;            // of the publisher; less than planned after a Limit
  std::deque<std::size_t> history;  // of a transient-local one: bytes of what it retains
  std::size_t history_bytes = 0;
  Way way;
};

class Sources {
 public:
  /// All must outlive it. `types` knows every planned type; `reaper` ends publishers.
  Sources(Node& node, const MessageTypes& types, Limits& limits, Reaper& reaper, const Log& log)
      : node_(node), types_(types), limits_(limits), reaper_(reaper), log_(log) {}

  /// Makes the publisher of a writer that has none.
  Result<OpenSource*> open(const Guid& writer, const Source& plan);
  /// Publishes the message, has it wait, or drops it.
  void publish(const Guid& writer, OpenSource& source, Received& received);
  /// Tries what waits, if it is time. Returns when it is next; nothing waits: never.
  std::optional<Time> publish_waiting(Time now);
  /// Ends those that have had their time. Returns when there is something to do again.
  std::optional<Time> tidy(Time now);
  /// At once, also what waits.
  void clear();

  /// By remote writer.
  std::map<Guid, OpenSource>& all() noexcept { return open_; }
  const std::map<Guid, OpenSource>& all() const noexcept { return open_; }

 private:
  Result<GenericPublisher::SharedPtr> make_publisher(const Source& plan, std::size_t depth) const;
  /// Makes room in the histories for a message of this source. False if there is none.
  bool fit_history(OpenSource& source, std::size_t bytes);
  void forget_history(OpenSource& source);
  /// False if keep-all holds it up; then it is still there.
  bool publish_now(OpenSource& source, Received& received);
  /// Whether one of those that wait was published.
  bool publish_held();
  void drop(OpenSource& source, const char* why, std::size_t messages = 1) const;
  void drop_waiting(const Guid& writer, OpenSource& source);

  Node& node_;
  const MessageTypes& types_;
  Limits& limits_;
  Reaper& reaper_;
  const Log& log_;
  std::map<Guid, OpenSource> open_;
  std::size_t history_bytes_ = 0;  // of all
  std::set<Guid> held_;            // writers whose sources have something waiting
  std::size_t held_bytes_ = 0;
  Time next_room_look_;  // at held_
  std::chrono::nanoseconds room_interval_{0};
};

}  // namespace agnocast::bridge
