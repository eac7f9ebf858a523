// SPDX-License-Identifier: Apache-2.0
//
// ROS 2 names: which are valid, why others are not, and how a node's own spelling becomes the
// fully qualified name that identifies a topic.
//
//   fully qualified   /token/token/…   token: a letter or underscore, then letters, digits,
//                     underscores; no slash at the end; at most 255 bytes
//   relative          token/token      in the namespace of the node
//   private           ~ or ~/token     below the fully qualified name of the node
//
// No remapping and no {substitutions} here; braces are refused with a sentence of their own.
#pragma once

#include <tl/expected.hpp>

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

namespace agnocast {

/// Without the terminating zero that is sent with it (abi::wire::Name).
inline constexpr std::size_t name_length_max = 255;

/// The first problem in a name.
struct NameProblem {
  const char* what = "";     ///< static text, without the position
  std::size_t position = 0;  ///< index of the offending byte

  /// "two slashes in a row, at character 4": characters are counted from 1.
  std::string text() const;
};

/// Returns nothing if `name` is a fully qualified topic name. Any thread; no allocation.
std::optional<NameProblem> check_topic_name(std::string_view name) noexcept;
/// Returns nothing if `name` can be the name of a node: one token.
std::optional<NameProblem> check_node_name(std::string_view name) noexcept;
/// Returns nothing if `name` can be a namespace: "/", or like a fully qualified topic name.
std::optional<NameProblem> check_namespace(std::string_view name) noexcept;

/// Returns the fully qualified form of `name` in the node `node_name` in `node_namespace`, both
/// valid. The position of a problem is one in `name`; for a result that is too long it is the
/// last byte there.
[[nodiscard]] tl::expected<std::string, NameProblem> expand_topic_name(
    std::string_view name, std::string_view node_name, std::string_view node_namespace);

}  // namespace agnocast
