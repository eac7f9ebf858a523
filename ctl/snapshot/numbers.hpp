// SPDX-License-Identifier: Apache-2.0
//
// Numbers: what the regions say now about endpoints and heap windows. These are counters for
// display: each is true at its own moment, and each process writes its own.
#pragma once

#include <ctl/snapshot/system.hpp>

#include <cstdint>
#include <optional>
#include <vector>

namespace agnocast::ctl {

/// The counters that a publisher keeps itself: two cache lines.
struct PublisherCounters {
  std::uint64_t published = 0;
  std::uint64_t published_bytes = 0;  // their total, everything that a reader may access
  std::uint64_t adopted_messages = 0;
  std::uint64_t adopted_bytes = 0;
  std::uint64_t refused_no_slot = 0;
  std::uint64_t refused_would_block = 0;
  std::uint64_t refused_heap_exhausted = 0;
};
/// The same, and the use of its queue: this reads each slot.
struct PublisherNumbers : PublisherCounters {
  std::uint64_t messages = 0;  // slots in use: history, unread or held
  std::uint64_t held = 0;      // those held by at least one subscription
};

struct SubscriptionNumbers {
  std::uint64_t linked = 0;  // publishers
  std::uint64_t held = 0;
  std::uint64_t unread = 0;  // those still within its depth
  std::uint64_t lost = 0;
  std::uint64_t malformed = 0;
  std::uint64_t unreachable = 0;
  std::uint64_t expired = 0;
};

/// Return nothing if the endpoint is gone or its region cannot be read.
std::optional<PublisherCounters> counters_of_publisher(const System& system, const Topic& topic,
                                                       const Endpoint& publisher);
std::optional<PublisherNumbers> numbers_of_publisher(const System& system, const Topic& topic,
                                                     const Endpoint& publisher);
/// The messages that its process could not map. The others cost a look at each publisher.
std::optional<std::uint64_t> unreachable_of_subscription(const System& system, const Topic& topic,
                                                         const Endpoint& subscription);
std::optional<SubscriptionNumbers> numbers_of_subscription(const System& system, const Topic& topic,
                                                           const Endpoint& subscription);

/// Commit times of a publisher's newest messages, CLOCK_MONOTONIC, the oldest first, and the
/// sequence number of the newest. At most `count`, as far back as their slots have not been
/// reused; empty if the publisher has published nothing or cannot be read.
struct RecentStamps {
  std::uint64_t newest = 0;
  std::vector<std::uint64_t> stamps_ns;
};
RecentStamps recent_stamps(const System& system, const Endpoint& publisher, std::size_t count);

/// Returns the messages a second at `now_ns`, the mean of those stamps, or less if the next
/// message is overdue. Nothing for fewer than two stamps; 0 if nothing was ever published.
std::optional<double> rate_of(const RecentStamps& recent, std::uint64_t now_ns) noexcept;
/// Returns `rate_hz`, or less if nothing has come since `newest_ns` for more than two periods.
double slowed(double rate_hz, std::uint64_t newest_ns, std::uint64_t now_ns) noexcept;

/// A message that has a slot in its publisher's queue.
struct MessageFacts {
  std::uint64_t sequence = 0;  // from 1, of this publisher
  std::uint64_t slot = 0;
  std::uint64_t address = 0;
  std::uint64_t object_bytes = 0;  // of the message object alone
  std::uint64_t stamp_ns = 0;      // CLOCK_MONOTONIC, when it was committed
  bool retired = false;            // no longer delivered
  std::vector<const Endpoint*> holders;
  std::vector<const Endpoint*> unread_by;
};
/// Returns the messages, the oldest first; empty if the publisher cannot be read.
std::vector<MessageFacts> messages_of(const System& system, const Topic& topic,
                                      const Endpoint& publisher);

/// The messages of all subscriptions of one process, and the memory of other processes that stays
/// in use for them.
struct KeptNumbers {
  std::uint64_t unread = 0;
  std::uint64_t held = 0;
  std::uint64_t lost = 0;
  std::uint64_t slots = 0;         // of publishers, each counted once
  std::uint64_t object_bytes = 0;  // of the message objects alone
};
KeptNumbers numbers_of_kept(const System& system, const Process& process);

/// The use of one heap window of a process.
struct WindowNumbers {
  std::uint64_t used_bytes = 0;  // the frontier
  std::uint64_t messages = 0;    // message objects that begin in it
};
/// Returns the bytes in use in all its heap windows; 0 if its region cannot be read.
std::uint64_t heap_used(const Process& process) noexcept;
/// Returns an entry for each heap window of the process; empty if its region cannot be read.
/// `messages` counts the slots of all its publishers.
std::vector<WindowNumbers> numbers_of_windows(const System& system, const Process& process);

}  // namespace agnocast::ctl
