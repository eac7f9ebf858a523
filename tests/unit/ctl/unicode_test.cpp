// SPDX-License-Identifier: Apache-2.0
//
// Goal: only well-formed text is accepted. Method: every character encoded and decoded; the
// malformed forms of the Unicode standard's own table.

#include <ctl/cli/unicode.hpp>

#include <gmock/gmock.h>

#include <string>

namespace agnocast::ctl {
namespace {

TEST(Unicode, EveryCharacterIsEncodedAndDecoded) {
  for (char32_t letter = 0; letter <= 0x10ffff; ++letter) {
    if (letter >= 0xd800 && letter <= 0xdfff) continue;
    std::string utf8;
    append_utf8(utf8, letter);
    const std::u32string one(1, letter);
    ASSERT_EQ(from_utf8(utf8), one) << static_cast<unsigned>(letter);
    const std::u16string words = to_utf16(one);
    ASSERT_EQ(from_utf16(words), one) << static_cast<unsigned>(letter);
    ASSERT_EQ(from_utf16_bytes(utf16_bytes(words)), words);
  }
}

TEST(Unicode, MalformedTextIsRefused) {
  for (const char* const bytes :
       {"\x80", "\xc3", "\xc3(", "\xc0\x80", "\xc1\xbf", "\xe0\x80\x80", "\xe0\x9f\xbf", "\xe2\x82",
        "\xed\xa0\x80", "\xed\xbf\xbf", "\xf0\x80\x80\x80", "\xf0\x8f\xbf\xbf", "\xf4\x90\x80\x80",
        "\xf5\x80\x80\x80", "\xf8\x88\x80\x80\x80", "\xfe", "\xff", "a\xffz"})
    EXPECT_EQ(from_utf8(bytes), std::nullopt) << bytes;
  for (const std::u16string& words :
       {std::u16string{0xd800}, std::u16string{0xdc00}, std::u16string{0xd800, u'a'},
        std::u16string{0xd800, 0xd800}, std::u16string{0xdc00, 0xd800}})
    EXPECT_EQ(from_utf16(words), std::nullopt);
  EXPECT_EQ(from_utf16_bytes("abc"), std::nullopt);
}

}  // namespace
}  // namespace agnocast::ctl
