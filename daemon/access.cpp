// SPDX-License-Identifier: Apache-2.0

#include <daemon/access.hpp>

#include <algorithm>
#include <bitset>

namespace agnocast::daemon {
namespace {

// Places of a pattern at which a match may stand; all are followed at once, so no pattern takes
// exponential time.
using Places = std::bitset<name_length_max + 1>;

bool is_double_star(std::string_view pattern, std::size_t at) noexcept {
  return pattern[at] == '*' && at + 1 < pattern.size() && pattern[at + 1] == '*';
}

// Stars may match nothing: whoever stands before one also stands behind it.
void pass_stars(std::string_view pattern, Places& places) noexcept {
  for (std::size_t at = 0; at < pattern.size(); ++at) {
    if (!places[at] || pattern[at] != '*') continue;
    places.set(at + (is_double_star(pattern, at) ? 2 : 1));
  }
}

}  // namespace

bool Principals::contains(uid_t uid, std::span<const gid_t> groups) const noexcept {
  if (everybody || std::find(uids.begin(), uids.end(), uid) != uids.end()) return true;
  return std::any_of(gids.begin(), gids.end(), [&](gid_t gid) {
    return std::find(groups.begin(), groups.end(), gid) != groups.end();
  });
}

bool topic_matches(std::string_view pattern, std::string_view topic) noexcept {
  if (pattern.size() > name_length_max) return false;
  Places places;
  places.set(0);
  pass_stars(pattern, places);
  for (const char c : topic) {
    Places next;
    for (std::size_t at = 0; at < pattern.size(); ++at) {
      if (!places[at]) continue;
      if (pattern[at] == '*') {
        if (c != '/' || is_double_star(pattern, at)) next.set(at);
      } else if (pattern[at] == c || (pattern[at] == '?' && c != '/')) {
        next.set(at + 1);
      }
    }
    pass_stars(pattern, next);
    places = next;
  }
  return places[pattern.size()];
}

std::optional<NameProblem> check_topic_pattern(std::string_view pattern) noexcept {
  if (pattern.empty()) return NameProblem{"the pattern is empty", 0};
  if (pattern.size() > name_length_max)
    return NameProblem{"the pattern is longer than 255 characters", name_length_max};
  if (pattern.front() != '/' && !pattern.starts_with("**"))
    return NameProblem{"a pattern starts with a slash or with **", 0};
  for (std::size_t i = 0; i < pattern.size(); ++i) {
    const char c = pattern[i];
    const bool is_name = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
                         (c >= '0' && c <= '9') || c == '_' || c == '/';
    if (!is_name && c != '*' && c != '?')
      return NameProblem{"only letters, digits, underscores, slashes, * and ? are allowed", i};
    if (i > 0 && c == '/' && pattern[i - 1] == '/') return NameProblem{"two slashes in a row", i};
    if (i > 1 && pattern.substr(i - 2, 3) == "***")
      return NameProblem{"more than two stars in a row", i};
  }
  if (pattern.back() == '/')
    return NameProblem{"a slash cannot be the last character", pattern.size() - 1};
  return std::nullopt;
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
