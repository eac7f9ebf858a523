// SPDX-License-Identifier: Apache-2.0
//
// Accounts: what each user has in use, in all and in each topic. Derived from the registry's tables
// and kept beside them.
#pragma once

#include <agnocast/abi/wire.hpp>
#include <daemon/state/tables.hpp>

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>

namespace agnocast::daemon {

using Kind = abi::wire::Kind;

/// What one user has in use. A dead process counts while others map its memory.
struct Usage {
  std::uint64_t clients = 0;
  std::uint64_t publishers = 0;
  std::uint64_t subscriptions = 0;
  std::uint64_t wait_sets = 0;
  std::uint64_t windows = 0;
  std::uint64_t heap_bytes = 0;
  std::uint64_t held_messages = 0;  // total that its subscriptions may hold
  std::uint64_t topics = 0;         // topics in which it has endpoints

  Usage& operator+=(const Usage& more) noexcept;
  Usage& operator-=(const Usage& less) noexcept;
  friend bool operator==(const Usage&, const Usage&) = default;
};

/// Places of one user in one topic, including gone publishers that are not yet read to their end.
struct Places {
  std::uint64_t publishers = 0;
  std::uint64_t subscriptions = 0;
};

class Accounts {
 public:
  void clear() noexcept { accounts_.clear(); }
  /// A process of this user has `part` besides its endpoints, or no longer has it.
  void add(std::uint32_t uid, const Usage& part);
  void subtract(std::uint32_t uid, const Usage& part);
  /// An endpoint of this user came or went. `held_messages`: how many messages it may hold; 0 for a
  /// publisher.
  void add_endpoint(std::uint32_t uid, Kind kind, TopicIndex topic, std::uint64_t held_messages);
  void remove_endpoint(std::uint32_t uid, Kind kind, TopicIndex topic, std::uint64_t held_messages);

  Usage usage_of(std::uint32_t uid) const;
  /// Returns whether a process of this user has an endpoint in the topic.
  bool takes_part(std::uint32_t uid, TopicIndex topic) const;
  /// Iterate over users that have something, and over the topics in which one has endpoints:
  /// return the first one after `after`, or the very first.
  std::optional<std::uint32_t> next_user(std::optional<std::uint32_t> after) const;
  std::optional<TopicIndex> next_topic_of(std::uint32_t uid, std::optional<TopicIndex> after) const;
  std::size_t user_count() const noexcept { return accounts_.size(); }
  bool has_user(std::uint32_t uid) const { return accounts_.count(uid) != 0; }
  Places user_places(std::uint32_t uid, TopicIndex topic) const;
  /// Returns the user's places in the topic where it has most, for each kind on its own.
  Places most_places_of(std::uint32_t uid) const;

 private:
  struct Account {
    Usage usage;
    std::map<std::uint32_t, Places> topics;  // by number
  };

  std::map<std::uint32_t, Account> accounts_;  // by uid
};

}  // namespace agnocast::daemon
