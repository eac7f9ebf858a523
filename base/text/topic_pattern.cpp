// SPDX-License-Identifier: Apache-2.0

#include <agnocast/topic_pattern.hpp>
#include <base/text/names.hpp>

#include <bitset>

namespace agnocast {
namespace {

// Positions in a pattern that a match may have reached; all are followed at once, so no pattern
// takes exponential time.
using Places = std::bitset<name_length_max + 1>;

bool is_double_star(std::string_view pattern, std::size_t at) noexcept {
  return pattern[at] == '*' && at + 1 < pattern.size() && pattern[at + 1] == '*';
}

// A star may match nothing: a match that has reached one has also passed it.
void pass_stars(std::string_view pattern, Places& places) noexcept {
  for (std::size_t at = 0; at < pattern.size(); ++at) {
    if (!places[at] || pattern[at] != '*') continue;
    places.set(at + (is_double_star(pattern, at) ? 2 : 1));
  }
}

std::optional<NameProblem> problem_of(std::string_view pattern) noexcept {
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

}  // namespace

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

std::optional<std::string> topic_pattern_problem(std::string_view pattern) {
  const auto problem = problem_of(pattern);
  return problem ? std::optional(problem->text()) : std::nullopt;
}

}  // namespace agnocast
