// SPDX-License-Identifier: Apache-2.0

#include <daemon/config/rule_reading.hpp>

#include <agnocast/topic_pattern.hpp>
#include <base/text/text.hpp>

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

namespace agnocast::daemon {
namespace {

constexpr std::uint64_t domain_count = std::uint64_t{1} << 32;  // larger than any ROS_DOMAIN_ID

constexpr std::string_view access_keys[] = {"topic", "domain", "publish", "subscribe"};

void read_topic(TomlReading& toml, const toml::node& node, AccessRule& rule) {
  const auto* const text = node.as_string();
  if (text == nullptr)
    return toml.wrong_type(node, "access.topic", "a pattern of topic names: \"/lidar/**\"");
  rule.topic = text->get();
  if (const auto problem = topic_pattern_problem(rule.topic)) {
    toml.report(node.source().begin, "access.topic", in_quotes(rule.topic) + ": " + *problem,
                "write a pattern of topic names: \"/lidar/**\"");
  }
}

void read_domain(TomlReading& toml, const toml::node& node, AccessRule& rule) {
  const auto* const number = node.as_integer();
  if (number == nullptr)
    return toml.wrong_type(node, "access.domain", "an integer, a ROS_DOMAIN_ID");
  if (number->get() < 0 || number->get() >= static_cast<std::int64_t>(domain_count)) {
    return toml.report(node.source().begin, "access.domain",
                       std::to_string(number->get()) + " is out of range",
                       "use 0 to " + std::to_string(domain_count - 1));
  }
  rule.domain = static_cast<std::uint64_t>(number->get());
}

// A rule that never decides shows that the order is wrong.
void check_shadowed(TomlReading& toml, const std::vector<AccessRule>& rules, const AccessRule& rule,
                    const Place& place) {
  for (const AccessRule& earlier : rules) {
    const bool covers =
        earlier.topic == rule.topic && (!earlier.domain || earlier.domain == rule.domain);
    if (!covers) continue;
    for (const auto& [is_given_twice, action] :
         {std::pair(earlier.publish && rule.publish, "publish"),
          std::pair(earlier.subscribe && rule.subscribe, "subscribe")}) {
      if (!is_given_twice) continue;
      toml.report(place, std::string("access.") + action,
                  "never decides: line " + std::to_string(earlier.line) +
                      " has the same topics and comes first",
                  "join both rules, or put the narrower one first");
    }
  }
}

void read_rule(TomlReading& toml, const toml::table& table, std::vector<AccessRule>& rules) {
  AccessRule rule;
  const Place& place = table.source().begin;
  rule.line = static_cast<std::uint32_t>(place.line);
  const std::size_t mistakes_before = toml.count();
  for (const auto& [key, node] : table) {
    if (key.str() == "topic") {
      read_topic(toml, node, rule);
    } else if (key.str() == "domain") {
      read_domain(toml, node, rule);
    } else if (key.str() == "publish") {
      rule.publish = toml.principals(node, "access.publish");
    } else if (key.str() == "subscribe") {
      rule.subscribe = toml.principals(node, "access.subscribe");
    } else {
      toml.unknown(key, "access." + escaped(key.str()), access_keys);
    }
  }
  if (!table.contains("topic"))
    toml.report(place, "access.topic", "is missing", "name the topics: topic = \"/lidar/**\"");
  if (!table.contains("publish") && !table.contains("subscribe"))
    toml.report(place, "access", "the rule has no effect", "add publish or subscribe with a list");
  if (toml.count() != mistakes_before) return;
  check_shadowed(toml, rules, rule, place);
  rules.push_back(std::move(rule));
}

}  // namespace

void read_access_rules(TomlReading& toml, const toml::node& node, std::vector<AccessRule>& rules) {
  for (const toml::table* const table : toml.tables(node, "access")) read_rule(toml, *table, rules);
}

}  // namespace agnocast::daemon
