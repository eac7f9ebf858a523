// SPDX-License-Identifier: Apache-2.0
//
// Goal: the progress of a case appears on the terminal while it runs, and nowhere else. Method: a
// Report with a file instead of the terminal.

#include <bench/case.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>
#include <string>

namespace agnocast::bench {
namespace {

using testing::ContainsRegex;
using testing::EndsWith;
using testing::HasSubstr;
using testing::Not;

class Progress : public testing::Test {
 protected:
  ~Progress() override {
    std::fclose(file_);
    std::free(text_);
  }
  std::string told() {
    std::fflush(file_);
    return {text_, size_};
  }

  char* text_ = nullptr;
  std::size_t size_ = 0;
  std::FILE* file_ = ::open_memstream(&text_, &size_);
  Report report{file_};
};

constexpr const char* cleared = "\r\033[K";

TEST_F(Progress, BeginsWithTheUsualTimeOfTheCase) {
  report.begin_case("latency", std::chrono::seconds(90));
  report.progress(0, 4, "one core");
  EXPECT_EQ(told(), "latency: 0 of 4, 90 s left, one core");
}

TEST_F(Progress, OmitsAnUnknownTime) {
  report.begin_case("latency", std::chrono::seconds(0));
  report.progress(0, 4, "one core");
  EXPECT_EQ(told(), "latency: 0 of 4, one core");
}

TEST_F(Progress, EstimatesFromTheTimeSoFar) {
  report.begin_case("latency", std::chrono::hours(1));
  report.progress(0, 4, "one core");
  report.progress(2, 4, "two cores");
  // This machine's speed is unknown, but two steps take less than an hour.
  EXPECT_THAT(told(), ContainsRegex("latency: 2 of 4, [0-9]+ s left, two cores$"));
  EXPECT_THAT(told(), Not(HasSubstr("of 4, 3600 s left, two")));
}

TEST_F(Progress, IsClearedWhenDoneOrBeforeOtherOutput) {
  report.begin_case("latency", std::chrono::seconds(0));
  report.is_quiet = true;
  report.progress(0, 2, "one core");
  report.say("a table");
  EXPECT_THAT(told(), EndsWith(cleared));
  report.progress(1, 2, "two cores");
  report.progress(2, 2, "");
  EXPECT_THAT(told(), EndsWith(std::string("two cores") + cleared));
  report.progress(0, 2, "one core");
  report.clear_bar();
  EXPECT_THAT(told(), EndsWith(std::string("one core") + cleared));
}

TEST_F(Progress, IsNotShownWithoutATerminal) {
  Report other(nullptr);
  other.begin_case("latency", std::chrono::seconds(1));
  other.progress(0, 2, "one core");
  EXPECT_EQ(told(), "");
}

TEST(Results, HaveTheNameOfTheirCase) {
  Report report(nullptr);
  report.begin_case("latency", std::chrono::seconds(0));
  report.add(nlohmann::json{{"system", "floor-futex"}});
  EXPECT_EQ(report.results,
            nlohmann::json::parse(R"([{"case": "latency", "system": "floor-futex"}])"));
}

}  // namespace
}  // namespace agnocast::bench
