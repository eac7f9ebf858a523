// SPDX-License-Identifier: Apache-2.0
//
// HoldWatch: finds subscriptions that hold more messages of a publisher than they asked for.
//
// The library takes nothing beyond the quota, so only a process that writes its lines itself gets
// there; what it holds is slots and memory of its publisher, who was promised a bound. Looking is
// for now and then and costs a bounded number of lines each time.
//
// A line is several words that its owner changes while they are read. So a bit counts only if it was
// set in two passes, and a subscription is reported only when that came out above its quota in
// several looks in a row: an honest one would have to release and take the same slots again between
// the words of each of them.
#pragma once

#include <daemon/regions.hpp>
#include <daemon/registry.hpp>

#include <cstdint>
#include <map>
#include <optional>
#include <tuple>

namespace agnocast::daemon {

class HoldWatch {
 public:
  HoldWatch(const Registry& registry, const Regions& regions) noexcept
      : registry_(registry), regions_(regions) {}

  struct Finding {
    EndpointRef subscription;
    std::uint64_t held = 0;  // of one publisher
    std::uint64_t quota = 0;
  };
  /// Looks at the next lines in turn, and again at those that were above their quota the last time.
  std::optional<Finding> look();

 private:
  using Key = std::tuple<std::uint32_t, std::uint32_t, std::uint32_t>;  // topic, subscription,
                                                                        // publisher
  struct Suspect {
    std::uint64_t generation = 0;  // of the subscription
    unsigned looks = 0;
  };

  std::uint64_t held_beyond_quota(TopicIndex topic, std::uint32_t subscription,
                                  std::uint32_t publisher) const;
  void go_on();

  const Registry& registry_;
  const Regions& regions_;
  std::uint32_t topic_ = 0, subscription_ = 0;  // where the last look ended
  std::map<Key, Suspect> suspects_;
};

}  // namespace agnocast::daemon
