// SPDX-License-Identifier: Apache-2.0
//
// Access: whether a user may publish on, or subscribe to, a topic. Pure; the rules are the
// [[access]] tables of the configuration in the order of the file.
//
// The first rule decides whose topic pattern and domain match *and* that has a list for the
// action; without one, every user may. So a restriction of everything is a last rule with topic =
// "**".
//
// Patterns are those of agnocast/topic_pattern.hpp.
//
// The rules hold for all users, root included.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::daemon {

enum class Action : std::uint8_t { publish, subscribe };

/// The users and groups in one list of a rule.
struct Principals {
  bool everybody = false;
  std::vector<uid_t> uids;
  std::vector<gid_t> gids;
  std::vector<std::string> written;  // as in the file

  bool contains(uid_t uid, std::span<const gid_t> groups) const noexcept;
  friend bool operator==(const Principals&, const Principals&) = default;
};

struct AccessRule {
  std::string topic;                    // pattern
  std::optional<std::uint64_t> domain;  // any when absent
  std::optional<Principals> publish;    // no rule for this action when absent
  std::optional<Principals> subscribe;
  std::uint32_t line = 0;  // of the file, for people; no part of the rule's meaning

  friend bool operator==(const AccessRule& a, const AccessRule& b) {
    return a.topic == b.topic && a.domain == b.domain && a.publish == b.publish &&
           a.subscribe == b.subscribe;
  }
};

struct Subject {
  uid_t uid = 0;
  std::vector<gid_t> groups;  // primary and supplementary
};

struct Decision {
  bool allowed = true;
  std::optional<std::size_t> rule;  // index of the deciding rule; none: the default
  std::uint32_t line = 0;           // of that rule
};

/// Returns the first rule that matches and has a list for the action; null: there is none.
const AccessRule* deciding_rule(std::span<const AccessRule> rules, std::uint64_t domain,
                                std::string_view topic, Action action) noexcept;
/// `topic` is a fully qualified name. Linear in the number of rules.
Decision decide(std::span<const AccessRule> rules, const Subject& subject, std::uint64_t domain,
                std::string_view topic, Action action) noexcept;

/// Returns a number for the set of users and groups who may subscribe to this topic: equal for
/// equal sets, however the rules write them. Never 0; everybody_reads when every user may. By it
/// the daemon compares the readers of a process's topics, whose messages lie in one heap.
std::uint64_t readers_of(std::span<const AccessRule> rules, std::uint64_t domain,
                         std::string_view topic) noexcept;
inline constexpr std::uint64_t everybody_reads = 1;

}  // namespace agnocast::daemon
