// SPDX-License-Identifier: Apache-2.0
//
// Goal: the error table is complete and says something useful. Method: walk it, and look at the
// texts a user would see.

#include <agnocast/error.hpp>
#include <agnocast/result.hpp>

#include <gmock/gmock.h>

#include <cerrno>
#include <set>
#include <string>

namespace agnocast {
namespace {

using testing::HasSubstr;

const Errc all_codes[] = {
#define AGNOCAST_CODE(name, sentence, remedy) Errc::name,
    AGNOCAST_ERROR_TABLE(AGNOCAST_CODE)
#undef AGNOCAST_CODE
};

TEST(Error, EveryCodeHasItsOwnSentenceAndARemedy) {
  std::set<std::string> sentences;
  for (Errc code : all_codes) {
    EXPECT_TRUE(sentences.insert(sentence_of(code)).second)
        << "sentence used twice: " << sentence_of(code);
    EXPECT_STRNE(remedy_of(code), "") << sentence_of(code);
  }
}

TEST(Error, NumbersOutsideTheTableAreNamedAsUnknown) {
  EXPECT_STREQ(sentence_of(static_cast<Errc>(-1)), "unknown error");
  EXPECT_STREQ(sentence_of(static_cast<Errc>(9999)), "unknown error");
}

TEST(Error, ExceptionNamesThePartTheErrnoAndTheSentence) {
  const Error error(Failure{Errc::os_failure, EACCES, "opening the socket"});
  EXPECT_THAT(error.what(), HasSubstr("opening the socket"));
  EXPECT_THAT(error.what(), HasSubstr("Permission denied"));
  EXPECT_THAT(error.what(), HasSubstr(sentence_of(Errc::os_failure)));
  EXPECT_EQ(error.code(), Errc::os_failure);
  EXPECT_STREQ(error.code().category().name(), "agnocast");
}

TEST(Result, CarriesTheFailureUnchanged) {
  const Result<int> result = fail(Errc::no_slot, "publish");
  ASSERT_FALSE(result.has_value());
  EXPECT_EQ(result.error().code, Errc::no_slot);
  EXPECT_EQ(result.error().os_errno, 0);
}

}  // namespace
}  // namespace agnocast
