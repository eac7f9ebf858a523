// SPDX-License-Identifier: Apache-2.0
//
// The meaning of quality of service, written as plainly as possible: lists of numbers, no shared
// memory. The stepped tests compare every take, every lost count and every would-block with it.
//
// A publisher is the list of its commits. A link remembers the number that a subscription takes
// next from one publisher. The unread messages of a link start there, and are at most the newest
// `window`. A keep-last subscription keeps its newest `depth` unread messages over all its
// publishers; the oldest is taken first. An unread message that leaves that set is lost. A late
// joiner starts after the newest; with transient_local on both sides it gets the newest min(depth,
// depth). A keep-all publisher commits only if no reliable keep-all subscription gets more than
// min(depth, depth) unread.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::test {

struct ReferenceQos {
  std::uint64_t depth = 1;
  bool transient_local = false, best_effort = false, keep_all = false;

  std::string text() const {
    return std::to_string(depth) + (transient_local ? "t" : "") + (best_effort ? "b" : "") +
           (keep_all ? "a" : "");
  }
  bool offers(const ReferenceQos& requested) const {
    return (transient_local || !requested.transient_local) &&
           (!best_effort || requested.best_effort);
  }
};

class Reference {
 public:
  struct Taken {
    std::uint64_t publisher, number;
  };
  struct Take {
    std::optional<Taken> taken;
    std::uint64_t lost;
    bool
        // false: the library counts some losses when it next looks at that publisher
        lost_is_exact;
  };

  void join_publisher(std::uint64_t id, const ReferenceQos& qos) {
    publishers_[id] = {qos, {}, true};
    for (auto& [_, subscription] : subscriptions_) {
      if (qos.offers(subscription.qos)) subscription.links[id] = {1, 0};
    }
  }
  /// Also for its death: its commits are still delivered.
  void leave_publisher(std::uint64_t id) { publishers_.at(id).here = false; }

  void join_subscription(std::uint64_t id, const ReferenceQos& qos, std::uint64_t quota) {
    Subscription& subscription = subscriptions_[id] = {qos, quota, {}, 0};
    for (const auto& [name, publisher] : publishers_) {
      if (!publisher.here || !publisher.qos.offers(qos)) continue;
      const bool history = publisher.qos.transient_local && qos.transient_local;
      const std::uint64_t back =
          history ? std::min({publisher.qos.depth, qos.depth, publisher.newest()}) : 0;
      subscription.links[name] = {publisher.newest() + 1 - back, 0};
    }
  }
  void leave_subscription(std::uint64_t id) { subscriptions_.erase(id); }

  /// Returns false if it would block; then nothing is committed.
  bool publish(std::uint64_t id) {
    Publisher& publisher = publishers_.at(id);
    for (const auto& [_, subscription] : subscriptions_) {
      const auto link = subscription.links.find(id);
      if (!publisher.qos.keep_all || !subscription.qos.keep_all || subscription.qos.best_effort ||
          link == subscription.links.end())
        continue;
      const std::uint64_t unread = publisher.newest() + 1 - link->second.wanted;
      if (unread + 1 > std::min(publisher.qos.depth, subscription.qos.depth)) return false;
    }
    publisher.time_of.push_back(++time_);
    return true;
  }

  Take take(std::uint64_t id) {
    Subscription& subscription = subscriptions_.at(id);
    drop_beyond_depth(subscription);
    const bool at_quota =
        std::any_of(subscription.links.begin(), subscription.links.end(),
                    [&](const auto& link) { return link.second.held == subscription.quota; });
    const auto oldest = oldest_unread(subscription, false);
    const bool exact =
        !at_quota && (!oldest || !subscription.qos.keep_all || subscription.links.size() < 2);
    if (!oldest) return {std::nullopt, subscription.lost, exact};
    Link& link = subscription.links.at(*oldest);
    ++link.held;
    return {Taken{*oldest, link.wanted++}, subscription.lost, exact};
  }
  void release(std::uint64_t id, std::uint64_t publisher) {
    --subscriptions_.at(id).links.at(publisher).held;
  }
  /// Returns how many active subscriptions a publisher has.
  std::uint64_t matched(std::uint64_t id) const {
    return static_cast<std::uint64_t>(
        std::count_if(subscriptions_.begin(), subscriptions_.end(),
                      [&](const auto& entry) { return entry.second.links.count(id) != 0; }));
  }

 private:
  struct Publisher {
    ReferenceQos qos;
    std::vector<std::uint64_t> time_of;  // of number 1, 2, …
    bool here;
    std::uint64_t newest() const { return time_of.size(); }
  };
  struct Link {
    std::uint64_t wanted, held;
  };
  struct Subscription {
    ReferenceQos qos;
    std::uint64_t quota;
    std::map<std::uint64_t, Link> links;
    std::uint64_t lost;
  };

  void drop_beyond_depth(Subscription& subscription) {
    // A keep-all subscription has room for one more than its bound (docs/protocol.md, keep-all).
    const std::uint64_t window = subscription.qos.depth + (subscription.qos.keep_all ? 1 : 0);
    std::uint64_t unread = 0;
    for (auto& [name, link] : subscription.links) {
      const std::uint64_t newest = publishers_.at(name).newest();
      while (newest + 1 - link.wanted > window) {
        ++link.wanted;
        ++subscription.lost;
      }
      unread += newest + 1 - link.wanted;
    }
    for (; !subscription.qos.keep_all && unread > subscription.qos.depth; --unread) {
      ++subscription.links.at(*oldest_unread(subscription, true)).wanted;
      ++subscription.lost;
    }
  }

  std::optional<std::uint64_t> oldest_unread(const Subscription& subscription,
                                             bool even_at_quota) const {
    std::optional<std::uint64_t> oldest;
    std::uint64_t oldest_time = 0;
    for (const auto& [name, link] : subscription.links) {
      const Publisher& publisher = publishers_.at(name);
      if (link.wanted > publisher.newest()) continue;
      if (!even_at_quota && link.held >= subscription.quota) continue;
      const std::uint64_t time = publisher.time_of[link.wanted - 1];
      if (oldest && oldest_time < time) continue;
      oldest = name;
      oldest_time = time;
    }
    return oldest;
  }

  std::map<std::uint64_t, Publisher> publishers_;
  std::map<std::uint64_t, Subscription> subscriptions_;
  std::uint64_t time_ = 0;
};

}  // namespace agnocast::test
