// SPDX-License-Identifier: Apache-2.0
//
// Goal: a command line means what --help says, and what means nothing is refused with a word on what would. Method: parse().

#include <bench/options.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace agnocast::bench {
namespace {

using std::chrono::microseconds;
using testing::ElementsAre;
using testing::HasSubstr;

Options parsed(const std::vector<std::string>& arguments) {
  return parse(arguments, {"latency", "fanout"}, {"floor-futex", "agnocast-take"});
}

TEST(Options, AreUnsetUnlessGiven) {
  const Options options = parsed({"latency"});
  EXPECT_EQ(options.error, "");
  EXPECT_THAT(options.cases, ElementsAre("latency"));
  EXPECT_FALSE(options.run.rounds || options.run.messages || options.run.period);
  EXPECT_TRUE(options.run.sizes.empty() && options.run.systems.empty());
  EXPECT_FALSE(options.run.is_small || options.is_list);
}

TEST(Options, AreRead) {
  const Options options =
      parsed({"fanout", "latency", "--rounds", "3", "--messages=20", "--period", "250us", "--sizes",
              "64,1K,1.5M", "--systems", "agnocast-take,floor-futex", "--json", "-", "--plot",
              "here", "--small"});
  EXPECT_EQ(options.error, "");
  EXPECT_THAT(options.cases, ElementsAre("fanout", "latency"));
  EXPECT_EQ(options.run.rounds, 3u);
  EXPECT_EQ(options.run.messages, 20u);
  EXPECT_EQ(options.run.period, microseconds(250));
  EXPECT_THAT(options.run.sizes, ElementsAre(64, 1024, 1536 * 1024));
  EXPECT_THAT(options.run.systems, ElementsAre("agnocast-take", "floor-futex"));
  EXPECT_EQ(options.json, "-");
  EXPECT_EQ(options.plot, "here");
  EXPECT_TRUE(options.run.is_small);
}

TEST(Options, AllIsEveryCase) {
  EXPECT_THAT(parsed({"all"}).cases, ElementsAre("latency", "fanout"));
}

TEST(Options, RefuseWhatMeansNothing) {
  EXPECT_THAT(parsed({"laziness"}).error, HasSubstr("latency fanout"));
  EXPECT_THAT(parsed({"latency", "--systems", "pigeon"}).error, HasSubstr("floor-futex"));
  for (const std::vector<std::string>& wrong : {std::vector<std::string>{},
                                                {"latency", "--rounds", "0"},
                                                {"latency", "--rounds", "many"},
                                                {"latency", "--sizes", "8"},
                                                {"latency", "--sizes", "1X"},
                                                {"latency", "--period", "1"},
                                                {"latency", "--scan", "/nowhere"},
                                                {"latency", "--unknown"}}) {
    EXPECT_NE(parsed(wrong).error, "") << testing::PrintToString(wrong);
  }
}

TEST(Options, HelpAndListNeedNoCase) {
  EXPECT_THAT(parsed({"--help"}).help, HasSubstr("--rounds"));
  EXPECT_EQ(parsed({"--list"}).error, "");
  EXPECT_TRUE(parsed({"--list"}).is_list);
}

TEST(Options, SizesAndTimes) {
  EXPECT_EQ(size_of("100"), 100u);
  EXPECT_EQ(size_of("100B"), 100u);
  EXPECT_EQ(size_of("8M"), 8u << 20);
  EXPECT_EQ(size_of("1KiB"), 1024u);
  for (const char* const wrong : {"", "K", "-1K", "1KK", "1T", "nan", "1e99"})
    EXPECT_EQ(size_of(wrong), 0u) << wrong;
  EXPECT_EQ(period_of("0us"), microseconds(0));
  EXPECT_EQ(period_of("1.5ms"), microseconds(1500));
  EXPECT_EQ(period_of("2s"), microseconds(2'000'000));
  for (const char* const wrong : {"", "1", "ms", "-1ms", "1m"})
    EXPECT_LT(period_of(wrong).count(), 0) << wrong;
  EXPECT_EQ(size_text(64), "64 B");
  EXPECT_EQ(size_text(100 * 1024), "100 KiB");
  EXPECT_EQ(size_text(8 << 20), "8 MiB");
}

}  // namespace
}  // namespace agnocast::bench
