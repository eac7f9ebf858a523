// SPDX-License-Identifier: Apache-2.0

#include <daemon/config/access.hpp>

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

std::uint64_t readers_of(std::span<const AccessRule> rules, std::uint64_t domain,
                         std::string_view topic) noexcept {
  const AccessRule* const rule = deciding_rule(rules, domain, topic, Action::subscribe);
  if (rule == nullptr || rule->subscribe->everybody) return everybody_reads;
  // A sum of one good hash for each different member, so their order does not matter.
  const auto number_of = [](std::uint64_t kind, std::uint64_t id) {
    std::uint64_t x = (kind << 32 | id) + 0x9e3779b97f4a7c15;  // splitmix64
    x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9;
    x = (x ^ x >> 27) * 0x94d049bb133111eb;
    return x ^ x >> 31;
  };
  std::uint64_t sum = number_of(0, 0);
  const auto add = [&](std::uint64_t kind, const auto& ids) {
    for (auto at = ids.begin(); at != ids.end(); ++at) {
      if (std::find(ids.begin(), at, *at) == at) sum += number_of(kind, *at);
    }
  };
  add(1, rule->subscribe->uids);
  add(2, rule->subscribe->gids);
  return sum > everybody_reads ? sum : sum + 2;
}

}  // namespace agnocast::daemon
