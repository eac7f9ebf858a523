// SPDX-License-Identifier: Apache-2.0

#include <base/text/names.hpp>

namespace agnocast {
namespace {

// Not <cctype>: names do not depend on a locale.
constexpr bool is_digit(char c) noexcept { return c >= '0' && c <= '9'; }
constexpr bool is_letter(char c) noexcept {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
}

const char* what_is(char c) noexcept {
  switch (c) {
    case '~':
      return "a tilde can only be the first character";
    case '{':
    case '}':
      return "substitutions in braces are not supported";
    case ' ':
      return "a space is not allowed";
    case '\0':
      return "a zero byte is not allowed";
    default:
      return "only letters, digits, underscores and slashes are allowed";
  }
}

// Checks tokens and the slashes between them, from `begin` to the end.
std::optional<NameProblem> check_tokens(std::string_view name, std::size_t begin) noexcept {
  if (name.size() > name_length_max)
    return NameProblem{"the name is longer than 255 characters", name_length_max};
  bool at_start = true;  // of a token
  for (std::size_t i = begin; i < name.size(); ++i) {
    const char c = name[i];
    if (c == '/') {
      if (at_start) return NameProblem{"two slashes in a row", i};
      at_start = true;
    } else if (is_digit(c)) {
      if (at_start) return NameProblem{"a digit cannot be the first character of a token", i};
    } else if (is_letter(c)) {
      at_start = false;
    } else {
      return NameProblem{what_is(c), i};
    }
  }
  if (at_start) return NameProblem{"a slash cannot be the last character", name.size() - 1};
  return std::nullopt;
}

}  // namespace

std::string NameProblem::text() const {
  return std::string(what) + ", at character " + std::to_string(position + 1);
}

std::optional<NameProblem> check_topic_name(std::string_view name) noexcept {
  if (name.empty()) return NameProblem{"the name is empty", 0};
  if (name.front() != '/') return NameProblem{"a fully qualified name starts with a slash", 0};
  return check_tokens(name, 1);
}

std::optional<NameProblem> check_node_name(std::string_view name) noexcept {
  if (name.empty()) return NameProblem{"the name is empty", 0};
  const std::size_t slash = name.find('/');
  if (slash != std::string_view::npos) return NameProblem{"the name of a node has no slash", slash};
  return check_tokens(name, 0);
}

std::optional<NameProblem> check_namespace(std::string_view name) noexcept {
  if (name == "/") return std::nullopt;
  return check_topic_name(name);
}

tl::expected<std::string, NameProblem> expand_topic_name(std::string_view name,
                                                         std::string_view node_name,
                                                         std::string_view node_namespace) {
  if (name.empty()) return tl::unexpected(NameProblem{"the name is empty", 0});
  std::string prefix;
  std::size_t tokens = 0;  // where those of `name` begin
  if (name.front() == '/') {
    tokens = 1;
    prefix = "/";
  } else {
    prefix = node_namespace;
    if (prefix.back() != '/') prefix += '/';
    if (name.front() == '~') {
      prefix += node_name;
      if (name.size() == 1) tokens = 1;
      if (name.size() > 1) {
        if (name[1] != '/')
          return tl::unexpected(NameProblem{"a slash has to follow the tilde", 1});
        prefix += '/';
        tokens = 2;
      }
    }
  }
  const bool is_node_itself = name == "~";
  if (!is_node_itself) {
    if (const auto problem = check_tokens(name, tokens)) return tl::unexpected(*problem);
  }
  std::string full = prefix + std::string(name.substr(tokens));
  if (full.size() > name_length_max) {
    return tl::unexpected(
        NameProblem{"the fully qualified name is longer than 255 characters", name.size() - 1});
  }
  return full;
}

}  // namespace agnocast
