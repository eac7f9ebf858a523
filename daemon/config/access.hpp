// SPDX-License-Identifier: Apache-2.0
//
// Access: may this user publish on, or subscribe to, this topic? Pure; the rules are the [[access]]
// tables of the configuration in the order of the file.
//
// The first rule whose topic pattern and domain match *and* that speaks of the action decides; when
// none does, everybody may. So a restriction of everything is a last rule with topic = "**".
//
// Patterns are those of agnocast/topic_pattern.hpp.
//
// Nobody is exempt, root included: a rule says what it says.
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

/// Who is meant by one list of a rule.
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
  std::optional<Principals> publish;    // says nothing when absent
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
  std::optional<std::size_t> rule;  // index of the one that decided; none: the default
  std::uint32_t line = 0;           // of that rule
};

/// The first rule that matches and speaks of the action; null: there is none.
const AccessRule* deciding_rule(std::span<const AccessRule> rules, std::uint64_t domain,
                                std::string_view topic, Action action) noexcept;
/// `topic` is a fully qualified name. Linear in the rules.
Decision decide(std::span<const AccessRule> rules, const Subject& subject, std::uint64_t domain,
                std::string_view topic, Action action) noexcept;

/// Who may subscribe to this topic, as a number: equal for equal sets of users and groups, however
/// the rules write them. Never 0; everybody_reads when everybody may. By it the daemon compares the
/// readers of the topics of a process, whose messages lie in one heap.
std::uint64_t readers_of(std::span<const AccessRule> rules, std::uint64_t domain,
                         std::string_view topic) noexcept;
inline constexpr std::uint64_t everybody_reads = 1;

}  // namespace agnocast::daemon
