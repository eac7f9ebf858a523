// SPDX-License-Identifier: Apache-2.0
//
// Text between bytes, UTF-16 words and letters; what of it may be written to a terminal.
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace agnocast::ctl {

/// Nothing if it is not well-formed.
std::optional<std::u32string> from_utf8(std::string_view bytes);
std::optional<std::u32string> from_utf16(std::u16string_view words);
void append_utf8(std::string& text, char32_t letter);
std::u16string to_utf16(std::u32string_view letters);

/// Words as bytes, the lower one first, and back; nothing if there is half a word.
std::string utf16_bytes(std::u16string_view words);
std::optional<std::u16string> from_utf16_bytes(std::string_view bytes);

/// Not: control characters, line separators, byte order marks, what turns the direction of writing,
/// and what is no character.
bool is_printable(char32_t letter);

}  // namespace agnocast::ctl
