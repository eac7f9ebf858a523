// SPDX-License-Identifier: Apache-2.0
//
// Patterns for topic names, as used by the daemon's access rules and the bridge:
//
//   *    any characters but a slash        ?   one character but a slash
//   **   any characters
#pragma once

#include <agnocast/export.hpp>

#include <optional>
#include <string>
#include <string_view>

namespace agnocast {

/// Returns whether a fully qualified name matches a pattern. Any thread; no allocation; time is
/// at most proportional to the product of both lengths.
AGNOCAST_PUBLIC bool topic_matches(std::string_view pattern, std::string_view topic) noexcept;
/// Returns why `pattern` can match no fully qualified name, as a sentence; nothing if it can.
AGNOCAST_PUBLIC std::optional<std::string> topic_pattern_problem(std::string_view pattern);

}  // namespace agnocast
