// SPDX-License-Identifier: Apache-2.0
//
// Goal: a user causes a bounded number of records about readers, whatever it reports and however
// fast, and uses up none of another user's. Method: time is an argument.

#include <daemon/requests/reader_notes.hpp>

#include <gtest/gtest.h>

namespace agnocast::daemon {
namespace {

TEST(ReaderNotes, AUserHasSomeAtOnceAndThenOneInAnInterval) {
  ReaderNotes notes;
  std::uint64_t now = 1'000'000;
  const auto taken = [&](std::uint32_t teller, int times, std::uint32_t reader = 2000) {
    std::uint64_t count = 0;
    for (int i = 0; i < times; ++i) count += notes.take(teller, reader, now);
    return count;
  };
  EXPECT_EQ(taken(1000, 500), ReaderNotes::at_once);
  EXPECT_EQ(taken(1001, 1), 1u) << "another user's record";
  EXPECT_EQ(taken(1000, 1, 2001), 1u) << "about the reader of another user";
  now += ReaderNotes::interval_ms;
  EXPECT_EQ(taken(1000, 500), 1u);
  notes.forget_unused(now);
  EXPECT_EQ(taken(1000, 500), 0u) << "a user with recent records is not forgotten";
  now += (ReaderNotes::at_once + 1) * ReaderNotes::interval_ms;
  notes.forget_unused(now);
  EXPECT_EQ(taken(1000, 500), ReaderNotes::at_once);
}

}  // namespace
}  // namespace agnocast::daemon
