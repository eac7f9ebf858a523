// SPDX-License-Identifier: Apache-2.0

#include <ctl/cli/unicode.hpp>

#include <cstddef>

namespace agnocast::ctl {

std::optional<std::u32string> from_utf8(std::string_view bytes) {
  std::u32string letters;
  letters.reserve(bytes.size());
  for (std::size_t i = 0; i < bytes.size();) {
    const auto first = static_cast<unsigned char>(bytes[i]);
    const std::size_t length = first < 0x80             ? 1
                               : (first & 0xe0) == 0xc0 ? 2
                               : (first & 0xf0) == 0xe0 ? 3
                               : (first & 0xf8) == 0xf0 ? 4
                                                        : 0;
    if (length == 0 || bytes.size() - i < length) return std::nullopt;
    char32_t letter = length == 1 ? first : first & (0x7fU >> length);
    for (std::size_t k = 1; k < length; ++k) {
      const auto next = static_cast<unsigned char>(bytes[i + k]);
      if ((next & 0xc0) != 0x80) return std::nullopt;
      letter = letter << 6 | (next & 0x3fU);
    }
    constexpr char32_t least[] = {0, 0, 0x80, 0x800, 0x10000};
    const bool is_surrogate = letter >= 0xd800 && letter <= 0xdfff;
    if (letter < least[length] || letter > 0x10ffff || is_surrogate) return std::nullopt;
    letters += letter;
    i += length;
  }
  return letters;
}

std::optional<std::u32string> from_utf16(std::u16string_view words) {
  std::u32string letters;
  letters.reserve(words.size());
  for (std::size_t i = 0; i < words.size(); ++i) {
    const char32_t word = words[i];
    if (word < 0xd800 || word > 0xdfff) {
      letters += word;
      continue;
    }
    if (word > 0xdbff || ++i == words.size()) return std::nullopt;
    const char32_t low = words[i];
    if (low < 0xdc00 || low > 0xdfff) return std::nullopt;
    letters += 0x10000 + ((word - 0xd800) << 10) + (low - 0xdc00);
  }
  return letters;
}

void append_utf8(std::string& text, char32_t letter) {
  const auto put = [&](char32_t byte) {
    text += static_cast<char>(static_cast<unsigned char>(byte));
  };
  if (letter < 0x80) return put(letter);
  if (letter < 0x800) {
    put(0xc0 | letter >> 6);
  } else {
    if (letter < 0x10000) {
      put(0xe0 | letter >> 12);
    } else {
      put(0xf0 | letter >> 18);
      put(0x80 | (letter >> 12 & 0x3f));
    }
    put(0x80 | (letter >> 6 & 0x3f));
  }
  put(0x80 | (letter & 0x3f));
}

std::u16string to_utf16(std::u32string_view letters) {
  std::u16string words;
  for (const char32_t letter : letters) {
    if (letter < 0x10000) {
      words += static_cast<char16_t>(letter);
    } else {
      words += static_cast<char16_t>(0xd800 + ((letter - 0x10000) >> 10));
      words += static_cast<char16_t>(0xdc00 + ((letter - 0x10000) & 0x3ff));
    }
  }
  return words;
}

std::string utf16_bytes(std::u16string_view words) {
  std::string bytes;
  for (const char16_t word : words) {
    bytes += static_cast<char>(word & 0xff);
    bytes += static_cast<char>(word >> 8);
  }
  return bytes;
}

std::optional<std::u16string> from_utf16_bytes(std::string_view bytes) {
  if (bytes.size() % 2 != 0) return std::nullopt;
  std::u16string words;
  for (std::size_t i = 0; i < bytes.size(); i += 2)
    words += static_cast<char16_t>(static_cast<unsigned char>(bytes[i]) |
                                   static_cast<unsigned char>(bytes[i + 1]) << 8);
  return words;
}

bool is_printable(char32_t letter) {
  if (letter < 0x20 || (letter >= 0x7f && letter < 0xa0)) return false;
  if (letter == 0xad || letter == 0x61c || letter == 0xfeff) return false;
  if (letter >= 0x200b && letter <= 0x200f) return false;
  if (letter >= 0x2028 && letter <= 0x202e) return false;
  if (letter >= 0x2060 && letter <= 0x206f) return false;
  if (letter >= 0xfff0 && letter <= 0xfffb) return false;
  if (letter >= 0xd800 && letter <= 0xf8ff) return false;  // surrogates, private use
  if (letter >= 0xfdd0 && letter <= 0xfdef) return false;
  if ((letter & 0xfffe) == 0xfffe) return false;
  return letter < 0xe0000;  // tags, and planes of private use
}

}  // namespace agnocast::ctl
