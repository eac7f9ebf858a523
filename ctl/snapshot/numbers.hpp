// SPDX-License-Identifier: Apache-2.0
//
// Numbers: what the regions say of endpoints and windows, now. Counters for people: each is true for
// a moment of its own, and what a process wrote about itself.
#pragma once

#include <ctl/snapshot/system.hpp>

#include <cstdint>
#include <optional>
#include <vector>

namespace agnocast::ctl {

/// What a publisher counts itself: two cache lines.
struct PublisherCounters {
  std::uint64_t published = 0;
  std::uint64_t published_bytes = 0;  // of them together, what a reader may touch
  std::uint64_t adopted_messages = 0;
  std::uint64_t adopted_bytes = 0;
  std::uint64_t refused_no_slot = 0;
  std::uint64_t refused_would_block = 0;
  std::uint64_t refused_heap_exhausted = 0;
};
/// And what of its queue is in use: each slot is looked at.
struct PublisherNumbers : PublisherCounters {
  std::uint64_t messages = 0;  // slots in use: history, unread or held
  std::uint64_t held = 0;      // of them, by at least one subscription
};

struct SubscriptionNumbers {
  std::uint64_t linked = 0;  // publishers
  std::uint64_t held = 0;
  std::uint64_t unread = 0;  // that are still in its depth
  std::uint64_t lost = 0;
  std::uint64_t malformed = 0;
  std::uint64_t unreachable = 0;
};

/// Nothing when the endpoint is gone, or its region cannot be read.
std::optional<PublisherCounters> counters_of_publisher(const System& system, const Topic& topic,
                                                       const Endpoint& publisher);
std::optional<PublisherNumbers> numbers_of_publisher(const System& system, const Topic& topic,
                                                     const Endpoint& publisher);
std::optional<SubscriptionNumbers> numbers_of_subscription(const System& system, const Topic& topic,
                                                           const Endpoint& subscription);

/// When the newest messages of a publisher were committed, CLOCK_MONOTONIC, the oldest first; and the
/// sequence number of the newest. As far back as their places have not been used again, at most `count`;
/// empty when it has published nothing, or cannot be read.
struct RecentStamps {
  std::uint64_t newest = 0;
  std::vector<std::uint64_t> stamps_ns;
};
RecentStamps recent_stamps(const System& system, const Endpoint& publisher, std::size_t count);

/// Messages a second, as those stamps have it at `now_ns`: the mean of the last few, less when the next
/// one is overdue. Nothing when there are fewer than two; 0 when nothing was ever published.
std::optional<double> rate_of(const RecentStamps& recent, std::uint64_t now_ns) noexcept;
/// `rate_hz`, or less when nothing has come since `newest_ns` for more than twice its period.
double slowed(double rate_hz, std::uint64_t newest_ns, std::uint64_t now_ns) noexcept;

/// A message that has a place in its publisher's queue.
struct MessageFacts {
  std::uint64_t sequence = 0;  // from 1, of this publisher
  std::uint64_t slot = 0;
  std::uint64_t address = 0;
  std::uint64_t object_bytes = 0;  // of the message object, without what it points to
  std::uint64_t stamp_ns = 0;      // CLOCK_MONOTONIC, when it was committed
  bool retired = false;            // not given to anybody any more
  std::vector<const Endpoint*> holders;
  std::vector<const Endpoint*> unread_by;
};
/// The oldest first. Empty when the publisher cannot be read.
std::vector<MessageFacts> messages_of(const System& system, const Topic& topic,
                                      const Endpoint& publisher);

/// What the subscriptions of one process have, together, and what of others' memory stays in use for
/// them.
struct KeptNumbers {
  std::uint64_t unread = 0;
  std::uint64_t held = 0;
  std::uint64_t lost = 0;
  std::uint64_t slots = 0;         // of publishers; one that two subscriptions hold counts once
  std::uint64_t object_bytes = 0;  // of the message objects in them, without what they point to
};
KeptNumbers numbers_of_kept(const System& system, const Process& process);

/// Of one window of a process.
struct WindowNumbers {
  std::uint64_t used_bytes = 0;  // the frontier
  std::uint64_t messages = 0;    // message objects that begin in it
};
/// How far its windows are in use, together; 0 when its region cannot be read.
std::uint64_t heap_used(const Process& process) noexcept;
/// As many as the process has windows; empty when its region cannot be read. `messages` counts the
/// slots of all its publishers.
std::vector<WindowNumbers> numbers_of_windows(const System& system, const Process& process);

}  // namespace agnocast::ctl
