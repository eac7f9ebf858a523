// SPDX-License-Identifier: Apache-2.0

#include <daemon/config/thread_rules.hpp>

#include <agnocast/topic_pattern.hpp>

#include <algorithm>
#include <cstring>
#include <type_traits>

namespace agnocast::daemon {
namespace {

using Scheduling = abi::wire::ThreadScheduling;
static_assert(std::has_unique_object_representations_v<Scheduling>, "so bytes can be compared");

// Most rules differ from a name in the text before the first star or question mark. Comparing that
// first spares the matcher, which takes time for each character of the pattern and of the name.
bool matches(const std::optional<std::string>& pattern, std::string_view name) noexcept {
  if (!pattern) return true;
  const std::size_t literal = std::min(pattern->find_first_of("*?"), pattern->size());
  return name.starts_with(std::string_view(*pattern).substr(0, literal)) &&
         topic_matches(*pattern, name);
}

}  // namespace

bool operator==(const ThreadRule& a, const ThreadRule& b) noexcept {
  return a.process == b.process && a.node == b.node && a.group == b.group && a.users == b.users &&
         std::memcmp(&a.scheduling, &b.scheduling, sizeof(Scheduling)) == 0 &&
         a.written_cpus == b.written_cpus;
}

std::optional<std::size_t> matching_rule(std::span<const ThreadRule> rules,
                                         const GroupNames& names) noexcept {
  const auto rule = std::find_if(rules.begin(), rules.end(), [&](const ThreadRule& one) {
    return matches(one.process, names.process) && matches(one.node, names.node) &&
           matches(one.group, names.group);
  });
  if (rule == rules.end()) return std::nullopt;
  return static_cast<std::size_t>(rule - rules.begin());
}

}  // namespace agnocast::daemon
