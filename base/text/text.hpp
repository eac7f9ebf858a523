// SPDX-License-Identifier: Apache-2.0
//
// Escapes untrusted text for log lines and for messages to people. Also guesses the intended word
// of a misspelt one.
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>

namespace agnocast {

/// Returns `text` in printable ASCII without quotes and backslashes of its own: \n, \t, \\, \",
/// and \xNN for the rest. Text longer than `length_max` bytes is cut before escaping and ends in
/// "...".
std::string escaped(std::string_view text, std::size_t length_max = 256);
/// The same between quotes.
std::string in_quotes(std::string_view text, std::size_t length_max = 256);

/// Returns the most similar word; empty if none is similar (more than a third of it differs).
std::string_view nearest(std::string_view wanted, std::span<const std::string_view> words);

}  // namespace agnocast
