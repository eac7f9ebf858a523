// SPDX-License-Identifier: Apache-2.0
//
// Goal: untrusted text cannot forge lines or drive a terminal, and a mistyped word finds the right
// one. Method: every byte, and tables.

#include <base/text/text.hpp>

#include <gtest/gtest.h>

#include <algorithm>

namespace agnocast {
namespace {

using namespace std::string_literals;

TEST(Text, EscapesAllButPlainText) {
  EXPECT_EQ(escaped("/camera/front"), "/camera/front");
  EXPECT_EQ(escaped("a\nb\tc"), "a\\nb\\tc");
  EXPECT_EQ(escaped("say \"hi\" \\"), "say \\\"hi\\\" \\\\");
  EXPECT_EQ(escaped("\x1b[31m\0\x7f\xc3\xa4"s), "\\x1b[31m\\x00\\x7f\\xc3\\xa4");
  EXPECT_EQ(in_quotes("a b"), "\"a b\"");
}

TEST(Text, EveryByteComesOutPrintableAndDifferent) {
  std::vector<std::string> seen;
  for (int value = 0; value < 256; ++value) {
    const std::string text = escaped(std::string(1, static_cast<char>(value)));
    EXPECT_TRUE(std::all_of(text.begin(), text.end(), [](char c) { return c >= ' ' && c <= '~'; }))
        << value;
    EXPECT_EQ(std::find(seen.begin(), seen.end(), text), seen.end()) << value;
    seen.push_back(text);
  }
}

TEST(Text, LongTextIsCut) {
  EXPECT_EQ(escaped("abcdef", 6), "abcdef");
  EXPECT_EQ(escaped("abcdefg", 6), "abcdef...");
  EXPECT_EQ(escaped("\n\n\n", 2), "\\n\\n...");
}

TEST(Text, NearestFindsOnlyTypingMistakes) {
  constexpr std::string_view words[] = {"depth_max", "clients", "topics", "--socket"};
  EXPECT_EQ(nearest("depht_max", words), "depth_max") << "two letters swapped";
  EXPECT_EQ(nearest("depthmax", words), "depth_max");
  EXPECT_EQ(nearest("client", words), "clients");
  EXPECT_EQ(nearest("topic", words), "topics");
  EXPECT_EQ(nearest("--sokcet", words), "--socket");
  EXPECT_EQ(nearest("clients", words), "clients");
  EXPECT_EQ(nearest("publishers", words), "");
  EXPECT_EQ(nearest("", words), "");
  EXPECT_EQ(nearest(std::string(100'000, 'x'), words), "");
  EXPECT_EQ(nearest("x", {}), "");
}

}  // namespace
}  // namespace agnocast
