// SPDX-License-Identifier: Apache-2.0

#include <daemon/access.hpp>

#include <agnocast/topic_pattern.hpp>

#include <algorithm>

namespace agnocast::daemon {
bool Principals::contains(uid_t uid, std::span<const gid_t> groups) const noexcept {
  if (everybody || std::find(uids.begin(), uids.end(), uid) != uids.end()) return true;
  return std::any_of(gids.begin(), gids.end(), [&](gid_t gid) {
    return std::find(groups.begin(), groups.end(), gid) != groups.end();
  });
}

const AccessRule* deciding_rule(std::span<const AccessRule> rules, std::uint64_t domain,
                                std::string_view topic, Action action) noexcept {
  for (const AccessRule& rule : rules) {
    const auto& who = action == Action::publish ? rule.publish : rule.subscribe;
    if (!who || (rule.domain && *rule.domain != domain)) continue;
    if (topic_matches(rule.topic, topic)) return &rule;
  }
  return nullptr;
}

Decision decide(std::span<const AccessRule> rules, const Subject& subject, std::uint64_t domain,
                std::string_view topic, Action action) noexcept {
  const AccessRule* const rule = deciding_rule(rules, domain, topic, action);
  if (rule == nullptr) return {};
  const auto& who = action == Action::publish ? rule->publish : rule->subscribe;
  return {who->contains(subject.uid, subject.groups), static_cast<std::size_t>(rule - rules.data()),
          rule->line};
}

}  // namespace agnocast::daemon
