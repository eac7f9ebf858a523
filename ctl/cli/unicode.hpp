// SPDX-License-Identifier: Apache-2.0
//
// Conversions between bytes, UTF-16 words and code points; code points that are safe to print.
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace agnocast::ctl {

/// Return nothing if the text is not well-formed.
std::optional<std::u32string> from_utf8(std::string_view bytes);
std::optional<std::u32string> from_utf16(std::u16string_view words);
void append_utf8(std::string& text, char32_t letter);
std::u16string to_utf16(std::u32string_view letters);

/// Convert words to bytes, the low byte first, and back; nothing for an odd number of bytes.
std::string utf16_bytes(std::u16string_view words);
std::optional<std::u16string> from_utf16_bytes(std::string_view bytes);

/// Returns false for control characters, line separators, byte order marks, characters that change
/// the direction of writing, and code points that are not characters.
bool is_printable(char32_t letter);

}  // namespace agnocast::ctl
