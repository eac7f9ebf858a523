// SPDX-License-Identifier: Apache-2.0

#include <bridge/plan/rules.hpp>

#include <agnocast/topic_pattern.hpp>

namespace agnocast::bridge {

Verdict verdict_of(std::span<const Rule> rules, std::string_view topic, std::string_view type,
                   Direction otherwise) noexcept {
  for (const Rule& rule : rules) {
    if ((rule.type.empty() || rule.type == type) && topic_matches(rule.topic, topic))
      return {rule.direction, &rule};
  }
  return {otherwise, nullptr};
}

}  // namespace agnocast::bridge
