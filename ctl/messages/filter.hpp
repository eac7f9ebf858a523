// SPDX-License-Identifier: Apache-2.0
//
// Filter: an expression over the fields of a message that selects messages.
//
//   expression = and { "or" and }
//   and        = not { "and" not }
//   not        = "not" not | comparison
//   comparison = operand [ ("==" | "!=" | "<" | "<=" | ">" | ">=") operand ]
//   operand    = number | string | "true" | "false" | place
//              | "len" "(" place ")" | "(" expression ")"
//   place      = ("m" | "msg") { "." name | "[" index "]" }
//
// The expression is checked against the type when it is parsed: numbers are compared with numbers,
// texts with texts, truth values with truth values. A missing place (an index beyond the end)
// makes its comparison false.
#pragma once

#include <ctl/cli/problem.hpp>
#include <ctl/messages/message_value.hpp>

#include <memory>
#include <string_view>

namespace agnocast::ctl {

class Filter {
 public:
  struct Node;
  /// Parses an expression. Problems: wrong_usage, with the position.
  static Outcome<Filter> parse(std::string_view text, const MessageMembers& type);
  bool accepts(const Value& message) const;
  Filter(Filter&&) noexcept;
  Filter& operator=(Filter&&) noexcept;
  ~Filter();

 private:
  explicit Filter(std::unique_ptr<const Node> root) noexcept;
  std::unique_ptr<const Node> root_;
};

}  // namespace agnocast::ctl
