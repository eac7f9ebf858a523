// SPDX-License-Identifier: Apache-2.0
//
// Goal: a subscription begins where the daemon let it begin, never before its publisher's first
// message, never behind the publisher's head, and not before its own window, whatever the
// publisher's head says. Method: words of a publisher and a line over plain memory.

#include <journal/start_steps.hpp>
#include <tests/unit/dataplane/dataplane_pair.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>

namespace agnocast::dataplane {
namespace {

class DataplaneStart : public testing::Test {
 protected:
  void head(std::uint64_t published) {
    pair.words().head().store(abi::pack_entry(Pair::first() + published, 3));
  }
  /// Links and returns the number of the first message that is wanted.
  std::uint64_t begins(bool from_start = false) {
    LinkCore<M> link = pair.link(0);
    EXPECT_TRUE(link.link(from_start));
    EXPECT_EQ(pair.line(0).cursor().load(), link.cursor());
    EXPECT_EQ(link.lost(), 0u);
    link.unlink();
    return link.cursor() - Pair::first();
  }

  Pair pair;
};

TEST_F(DataplaneStart, IsBehindTheHeadAtItsJoin) {
  head(5);
  journal::set_start<M>(pair.words(), pair.line(0));
  head(8);
  EXPECT_EQ(begins(), 6u);
}

TEST_F(DataplaneStart, IsBehindTheHeadAtItsLinkWhereTheDaemonSetNone) {
  head(8);
  EXPECT_EQ(begins(), 9u);
}

TEST_F(DataplaneStart, IsTheFirstMessageOfAPublisherThatJoinedLater) {
  head(5);
  journal::set_start<M>(pair.words(), pair.line(0));
  EXPECT_EQ(begins(true), 1u);
}

TEST_F(DataplaneStart, IncludesTheHistoryThatWasThereAtItsJoin) {
  pair.offered.transient_local = pair.requested.transient_local = true;
  head(10);
  journal::set_start<M>(pair.words(), pair.line(0));
  head(12);
  EXPECT_EQ(begins(), 7u) << "four messages of history";
}

TEST_F(DataplaneStart, IsNotBeforeItsWindow) {
  head(5);
  journal::set_start<M>(pair.words(), pair.line(0));
  head(100);
  EXPECT_EQ(begins(), 93u) << "a depth of eight";
}

TEST_F(DataplaneStart, LiesWithinTheQueueWhateverAPublisherWritesAsItsHead) {
  std::mt19937_64 random(3);
  for (int i = 0; i < 10'000; ++i) {
    pair.words().head().store(nasty(random));
    journal::set_start<M>(pair.words(), pair.line(0));
    ASSERT_NE(pair.line(0).cursor().load(), 0u);
    const std::uint64_t published = random() % 50;
    head(published);
    const std::uint64_t first = begins();
    ASSERT_GE(first,
              std::max<std::uint64_t>(1, published + 1 - std::min<std::uint64_t>(published, 8)));
    ASSERT_LE(first, published + 1);
  }
}

}  // namespace
}  // namespace agnocast::dataplane
