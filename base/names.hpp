// SPDX-License-Identifier: Apache-2.0
//
// Names as ROS 2 has them: which are allowed, what is wrong with the others, and how a node's own
// spelling becomes the fully qualified name that identifies a topic.
//
//   fully qualified   /token/token/…   token: a letter or underscore, then letters, digits,
//                     underscores; no slash at the end; at most 255 bytes
//   relative          token/token      lies in the namespace of the node
//   private           ~ or ~/token     lies under the fully qualified name of the node
//
// Remapping and {substitutions} are not done here; braces are refused with a sentence of their own.
#pragma once

#include <tl/expected.hpp>

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

namespace agnocast {

/// What travels has one byte more, for the terminating zero (abi::wire::Name).
inline constexpr std::size_t name_length_max = 255;

/// The first thing that is wrong with a name.
struct NameProblem {
  const char* what = "";     ///< static text, without the position
  std::size_t position = 0;  ///< index of the offending byte

  /// "two slashes in a row, at character 4": characters are counted from 1, for people.
  std::string text() const;
};

/// Nothing when `name` is a fully qualified topic name. Any thread; no allocation.
std::optional<NameProblem> check_topic_name(std::string_view name) noexcept;
/// Nothing when `name` can be the name of a node: one token.
std::optional<NameProblem> check_node_name(std::string_view name) noexcept;
/// Nothing when `name` can be a namespace: "/", or like a fully qualified topic name.
std::optional<NameProblem> check_namespace(std::string_view name) noexcept;

/// The fully qualified name of what the node `node_name` in `node_namespace`, both valid, calls
/// `name`. The position of a problem is one in `name`; a result that is too long has the position
/// of its last byte there.
[[nodiscard]] tl::expected<std::string, NameProblem> expand_topic_name(
    std::string_view name, std::string_view node_name, std::string_view node_namespace);

}  // namespace agnocast
