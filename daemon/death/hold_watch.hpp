// SPDX-License-Identifier: Apache-2.0
//
// HoldWatch: finds subscriptions that hold more messages of a publisher than they asked for.
//
// The library takes nothing beyond the quota, so only a process that writes its lines itself gets
// there; it holds slots and memory of a publisher that was promised a bound. A look happens now
// and then and reads a bounded number of lines. Each user has time slices with a share of the
// lines and continues where its last one ended: a user with very many lines is looked at as often
// as the others, and only its own round takes longer.
//
// A line is several words that its owner changes while they are read. So a bit counts only if two
// reads find it set, and a subscription is reported only after several looks in a row above its
// quota: an honest one would have to release and take the same slots again between the reads of
// every look.
#pragma once

#include <daemon/lifecycle/regions.hpp>
#include <daemon/state/registry.hpp>

#include <cstdint>
#include <map>
#include <optional>
#include <tuple>
#include <vector>

namespace agnocast::daemon {

class HoldWatch {
 public:
  HoldWatch(const Registry& registry, const Regions& regions) noexcept
      : registry_(registry), regions_(regions) {}

  struct Finding {
    EndpointRef subscription;
    std::uint64_t held = 0;  // messages of one publisher
    std::uint64_t quota = 0;
  };
  /// Looks at the next lines in turn, and again at those that were above their quota the last
  /// time. Returns at most one finding for each user: the end of its process is work, and others
  /// must not wait for it.
  std::vector<Finding> look();

 private:
  using Key = std::tuple<std::uint32_t, std::uint32_t, std::uint32_t>;  // topic, subscription,
                                                                        // publisher
  struct Suspect {
    std::uint64_t generation = 0;  // generation of the subscription
    unsigned looks = 0;
  };

  std::uint64_t held_beyond_quota(TopicIndex topic, std::uint32_t subscription,
                                  std::uint32_t publisher) const;
  /// Where the round of a user is: the topic, and the first place there still to be looked at.
  struct Position {
    std::optional<TopicIndex> topic;
    std::uint32_t place = 0;
  };
  void go_on();
  /// Returns the number of steps taken.
  std::uint32_t use_time_slice(std::uint32_t uid, Position& at);
  std::uint32_t look_at(TopicIndex topic, std::uint32_t subscription);

  const Registry& registry_;
  const Regions& regions_;
  std::optional<std::uint32_t> last_user_;       // the user of the last time slice
  std::map<std::uint32_t, Position> positions_;  // by uid
  std::map<Key, Suspect> suspects_;
};

}  // namespace agnocast::daemon
