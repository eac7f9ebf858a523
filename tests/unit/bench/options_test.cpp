// SPDX-License-Identifier: Apache-2.0
//
// Goal: a command line means what --help says, and a refusal names what is right. Method: parse().

#include <bench/options.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace agnocast::bench {
namespace {

using std::chrono::microseconds;
using testing::ElementsAre;
using testing::HasSubstr;

const std::vector<Case> some_cases{
    {"latency",
     "one to one",
     std::chrono::seconds(60),
     nullptr,
     {"--rounds", "--messages", "--period", "--sizes", "--systems"},
     [] {
       return std::vector<SystemName>{{"floor-futex", "a futex"}, {"agnocast-take", "take()"}};
     }},
    {"fanout",
     "one to many",
     std::chrono::seconds(60),
     nullptr,
     {"--rounds", "--sizes", "--systems"},
     [] {
       return std::vector<SystemName>{{"floor-futex", "another"}, {"floor-line", "a line"}};
     },
     1},
    {"alloc", "malloc", std::chrono::seconds(60), nullptr, {"--rounds"}},
    {"throughput",
     "a second",
     std::chrono::seconds(60),
     nullptr,
     {"--sizes"},
     nullptr,
     SIZE_MAX,
     {64, 1 << 20}},
};

Options parsed(const std::vector<std::string>& arguments) { return parse(arguments, some_cases); }

TEST(Options, AreUnsetUnlessGiven) {
  const Options options = parsed({"latency"});
  EXPECT_EQ(options.error, "");
  EXPECT_THAT(options.cases, ElementsAre("latency"));
  EXPECT_FALSE(options.run.rounds || options.run.messages || options.run.period);
  EXPECT_TRUE(options.run.sizes.empty() && options.run.systems.empty());
  EXPECT_FALSE(options.run.is_small || options.is_list);
  EXPECT_TRUE(options.is_default);
  EXPECT_FALSE(parsed({"latency", "--rounds", "7"}).is_default);
  EXPECT_FALSE(parsed({"latency", "--small"}).is_default);
}

TEST(Options, AreRead) {
  const Options options =
      parsed({"alloc", "latency", "--rounds", "3", "--messages=20", "--period", "250us", "--sizes",
              "64,1K,1.5M", "--systems", "agnocast-take,floor-futex", "--json", "-", "--plot",
              "here", "--small"});
  EXPECT_EQ(options.error, "");
  EXPECT_THAT(options.cases, ElementsAre("alloc", "latency"));
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
  EXPECT_THAT(parsed({"all"}).cases, ElementsAre("latency", "fanout", "alloc", "throughput"));
}

TEST(Options, RefuseMeaninglessValues) {
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

TEST(Options, ReadByNoCaseAreRefused) {
  EXPECT_EQ(parsed({"fanout", "--period", "1ms"}).error,
            "fanout does not take --period; leave it out, or ask for latency");
  EXPECT_EQ(parsed({"fanout", "alloc", "--messages", "5"}).error,
            "none of fanout, alloc takes --messages; leave it out, or ask for latency");
  EXPECT_EQ(parsed({"latency", "--scan", "/dev/null"}).error,
            "latency does not take --scan; leave it out");
  EXPECT_EQ(parsed({"alloc", "--rounds", "2"}).error, "");
  // One case that reads it is enough.
  EXPECT_EQ(parsed({"fanout", "latency", "--period", "1ms"}).error, "");
  EXPECT_EQ(parsed({"all", "--messages", "5"}).error, "");
}

TEST(Options, NamingSystemsThatNoCaseComparesAreRefused) {
  EXPECT_EQ(parsed({"latency", "--systems", "floor-line"}).error,
            "latency does not take --systems floor-line; leave it out, or ask for fanout");
  EXPECT_EQ(parsed({"latency", "fanout", "--systems", "floor-line,agnocast-take"}).error, "");
  EXPECT_THAT(systems_of(some_cases),
              ElementsAre(testing::Field(&SystemName::summary, "a futex"),
                          testing::Field(&SystemName::name, "agnocast-take"),
                          testing::Field(&SystemName::name, "floor-line")));
}

TEST(Options, WithSizesThatACaseCannotHaveAreRefused) {
  EXPECT_EQ(parsed({"fanout", "--sizes", "1K"}).error, "");
  const std::string refused =
      "fanout does not take more than one of --sizes; say one, or leave fanout out";
  EXPECT_EQ(parsed({"fanout", "--sizes", "1K,1M"}).error, refused);
  EXPECT_EQ(parsed({"fanout", "latency", "--sizes", "1K,1M"}).error, refused);
  EXPECT_EQ(parsed({"all", "--sizes", "64,1M"}).error, refused);
  EXPECT_EQ(parsed({"throughput", "alloc", "--sizes", "64,1M"}).error, "");
  EXPECT_EQ(parsed({"throughput", "latency", "--sizes", "1K"}).error,
            "throughput has messages of 64 B and 1 MiB only, and none of 1 KiB; leave it out of "
            "--sizes, or leave throughput out");
  EXPECT_EQ(parsed({"all", "--sizes", "1M"}).error, "");
}

TEST(Options, OfEachCaseAreInTheHelp) {
  EXPECT_THAT(parsed({"--help"}).help, HasSubstr("alloc: --rounds\n"));
  EXPECT_THAT(parsed({"--help"}).help, HasSubstr("fanout: --rounds --sizes (one) --systems\n"));
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
