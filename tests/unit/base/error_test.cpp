// SPDX-License-Identifier: Apache-2.0
//
// Goal: the error table is complete and every entry is useful. Method: walk it, and look at the
// texts a user would see.

#include <agnocast/error.hpp>
#include <agnocast/result.hpp>

#include <gmock/gmock.h>

#include <cctype>
#include <cerrno>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <sstream>
#include <string>
#include <thread>
#include <type_traits>
#include <vector>

namespace agnocast {
namespace {

const Errc all_codes[] = {
#define AGNOCAST_CODE(name, sentence, cause, remedy) Errc::name,
    AGNOCAST_ERROR_TABLE(AGNOCAST_CODE)
#undef AGNOCAST_CODE
};

TEST(Error, EveryCodeHasItsOwnSentenceCauseAndRemedy) {
  std::set<std::string> sentences;
  for (Errc code : all_codes) {
    EXPECT_TRUE(sentences.insert(sentence_of(code)).second)
        << "sentence used twice: " << sentence_of(code);
    EXPECT_STRNE(cause_of(code), "") << sentence_of(code);
    EXPECT_STRNE(remedy_of(code), "") << sentence_of(code);
    EXPECT_STRNE(word_of(code), "?") << sentence_of(code);
  }
}

TEST(Error, NumbersOutsideTheTableAreNamedAsUnknown) {
  EXPECT_STREQ(sentence_of(static_cast<Errc>(-1)), "unknown error");
  EXPECT_STREQ(sentence_of(static_cast<Errc>(9999)), "unknown error");
}

// The documentation has the same table, row by row.
TEST(Error, DocumentationHasTheTable) {
  std::string rows;
  for (const Errc code : all_codes)
    rows += std::string("| `") + word_of(code) + "` | " + sentence_of(code) + " | " +
            cause_of(code) + " | " + remedy_of(code) + " |\n";
  std::ifstream file(AGNOCAST_SOURCE_DIR "/docs/errors.md");
  std::stringstream text;
  text << file.rdbuf();
  EXPECT_NE(text.str().find(
                "| code | what | usually because | what to do |\n| --- | --- | --- | --- |\n" +
                rows + "\n"),
            std::string::npos)
      << "docs/errors.md should have\n"
      << rows;
}

std::string texts_below(const std::vector<std::string>& folders) {
  std::string all;
  for (const std::string& folder : folders) {
    for (const auto& entry :
         std::filesystem::recursive_directory_iterator(AGNOCAST_SOURCE_DIR "/" + folder)) {
      const std::string name = entry.path().filename();
      if (entry.path().extension() != ".cpp" && entry.path().extension() != ".hpp") continue;
      if (name == "error.cpp" || name == "error.hpp" || name == "error_test.cpp") continue;
      std::ifstream file(entry.path());
      all.append(std::istreambuf_iterator<char>(file), {});
    }
  }
  return all;
}

bool has_word(const std::string& text, const std::string& word) {
  const auto is_part = [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) || c == '_';
  };
  for (std::size_t at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) {
    if (at + word.size() == text.size() || !is_part(text[at + word.size()])) return true;
  }
  return false;
}

// A code that nothing returns makes users handle what never happens; one that no test meets may be
// returned in the wrong place. A test names the code that it expects, or its word in an answer.
TEST(Error, EveryCodeIsReturnedSomewhereAndExpectedByATest) {
  const std::string product =
      texts_below({"base", "client", "ctl", "daemon", "heaphook", "include", "journal"});
  const std::string tests = texts_below({"tests"});
  for (const Errc code : all_codes) {
    const std::string word = word_of(code);
    EXPECT_TRUE(has_word(product, "Errc::" + word)) << word << " is returned nowhere";
    // It stands for a fault of ours, which no test can cause from outside.
    if (code == Errc::internal) continue;
    EXPECT_TRUE(has_word(tests, "Errc::" + word) || has_word(tests, '"' + word) ||
                has_word(tests, ": " + word))
        << "no test expects " << word;
  }
}

TEST(Error, ExceptionSaysWhatFailedThenWhy) {
  const Error error(Failure{Errc::os_failure, EACCES, "opening the socket"});
  EXPECT_STREQ(error.what(),
               "the operating system refused an operation: opening the socket: Permission denied");
  EXPECT_EQ(error.code(), Errc::os_failure);
  EXPECT_STREQ(error.code().category().name(), "agnocast");
  EXPECT_STREQ(error.remedy(), remedy_of(Errc::os_failure));
  EXPECT_STREQ(Error(Failure{Errc::no_slot, 0, ""}).what(), sentence_of(Errc::no_slot));
}

TEST(Error, ACopyOfAnExceptionKeepsItsText) {
  std::string text;
  std::exception_ptr kept;
  try {
    throw Error(failure_with(Errc::invalid_name, "\"a b\": a space", 0));
  } catch (const Error& error) {
    kept = std::make_exception_ptr(error);
  }
  (void)failure_with(Errc::invalid_name, "another one");
  try {
    std::rethrow_exception(kept);
  } catch (const std::exception& error) {
    text = error.what();
  }
  EXPECT_EQ(text, "a name is not a ROS 2 name: \"a b\": a space");
}

TEST(Failure, KeepsItsDetailInItsThreadUntilTheNextOne) {
  static_assert(std::is_trivially_copyable_v<Failure>);
  const Failure first = failure_with(Errc::depth_refused, "depth 0");
  const Failure copy = first;
  EXPECT_STREQ(detail_of(copy), "depth 0");
  const Failure plain{Errc::no_slot, 0, "publish"};
  EXPECT_STREQ(detail_of(plain), "");
  std::thread([&] {
    EXPECT_STREQ(detail_of(first), "") << "the detail belongs to another thread";
    const Failure theirs = failure_with(Errc::depth_refused, "depth 9");
    EXPECT_STREQ(detail_of(theirs), "depth 9");
    EXPECT_STREQ(detail_of(first), "");
  }).join();
  EXPECT_STREQ(detail_of(first), "depth 0");
  const Failure again = failure_with(Errc::depth_refused, detail_of(first));
  EXPECT_STREQ(detail_of(again), "depth 0") << "a failure may be made from its own detail";
  EXPECT_STREQ(detail_of(first), "");
  EXPECT_EQ(text_of(first), sentence_of(Errc::depth_refused))
      << "never the detail of another failure";
}

TEST(Failure, CutsADetailThatIsTooLong) {
  const std::string text(detail_bytes_max + 100, 'x');
  EXPECT_EQ(std::string(detail_of(failure_with(Errc::internal, text.c_str()))).size(),
            detail_bytes_max - 1);
}

TEST(Result, CarriesTheFailureUnchanged) {
  const Result<int> result = fail(Errc::no_slot, "publish");
  ASSERT_FALSE(result.has_value());
  EXPECT_EQ(result.error().code, Errc::no_slot);
  EXPECT_EQ(result.error().os_errno, 0);
}

}  // namespace
}  // namespace agnocast
