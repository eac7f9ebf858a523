// SPDX-License-Identifier: Apache-2.0
//
// Goal: publisher and subscription match by the rules of DDS 1.4, 2.2.3, and a publisher takes part
// by the same rules from what the board says.
// Method: a keep-all publisher waits for a keep-all subscription exactly if they match.

#include <journal/board_steps.hpp>
#include <journal/mismatch.hpp>
#include <tests/unit/dataplane/dataplane_pair.hpp>

#include <gtest/gtest.h>

#include <memory>

namespace agnocast::dataplane {
namespace {

static_assert(!abi::is_longer(0, 0) && !abi::is_longer(5, 0) && abi::is_longer(0, 5));
static_assert(!abi::is_longer(5, 5) && abi::is_longer(6, 5) && !abi::is_longer(5, 6));
static_assert(!abi::is_longer(abi::qos_time_max_ns, 0) && abi::is_longer(0, abi::qos_time_max_ns));

struct Case {
  abi::Qos offered, requested;
  abi::QosPolicy mismatch;
  const char* text;
};
constexpr abi::Qos with(bool manual, std::uint64_t deadline_ns, std::uint64_t lease_ns) {
  return {2, false, true, true, false, manual, deadline_ns, 0, lease_ns};
}
constexpr std::uint64_t ms = 1'000'000;
const Case cases[] = {
    {with(false, 0, 0), with(false, 0, 0), abi::QosPolicy::none, ""},
    {with(true, 5, 3), with(true, 5, 3), abi::QosPolicy::none, ""},
    {with(true, 5, 3), with(false, 0, 0), abi::QosPolicy::none, ""},
    {with(false, 4, 2), with(false, 5, 3), abi::QosPolicy::none, ""},
    {with(false, 6 * ms, 3), with(false, 5, 3), abi::QosPolicy::deadline,
     "a deadline of 5 ns is requested, 6 ms is offered"},
    {with(false, 0, 3), with(false, 5 * ms, 3), abi::QosPolicy::deadline,
     "a deadline of 5 ms is requested, none is offered"},
    {with(false, 5, 3), with(true, 5, 3), abi::QosPolicy::liveliness,
     "liveliness manual_by_topic is requested, automatic is offered"},
    {with(false, 5, 4), with(false, 5, 3), abi::QosPolicy::liveliness_lease,
     "a liveliness lease of 3 ns is requested, 4 ns is offered"},
    {with(false, 5, 0), with(false, 5, 3), abi::QosPolicy::liveliness_lease,
     "a liveliness lease of 3 ns is requested, none is offered"},
};

TEST(Matching, EachSideComparesAllPolicies) {
  for (const Case& one : cases) {
    SCOPED_TRACE(one.text);
    EXPECT_EQ(abi::qos_mismatch(one.offered, one.requested), one.mismatch);
    EXPECT_EQ(journal::mismatch_text(one.offered, one.requested), one.text);
    Pair pair;
    journal::BoardSteps<M>(pair.topic()).add_subscription(0, 1, {one.requested, 1, extent, 8, 0});
    auto publisher = std::make_unique<PublisherCore<M>>(PublisherCore<M>::Identity{
        pair.topic(), pair.words(), 0, generation, Pair::first(), one.offered, 64, 0, 0});
    Freed environment;
    PublishOutcome outcome = PublishOutcome::published;
    for (std::uint64_t at = 16; at <= 160 && outcome == PublishOutcome::published; at += 16)
      outcome = publisher->publish({*environment.live.insert(at).first, 16, at}, environment);
    EXPECT_EQ(outcome, one.mismatch == abi::QosPolicy::none ? PublishOutcome::would_block
                                                            : PublishOutcome::published);
  }
}

// What is published after the look is newer than all that was compared.
TEST(PassingOver, GoesNoFurtherThanTheLook) {
  for (const bool keeps_one : {false, true}) {
    Pair pair;
    pair.offered.transient_local = true;  // it keeps what nobody attached to it reads
    if (keeps_one) pair.requested.depth = 1;
    auto publisher = std::make_unique<PublisherCore<M>>(PublisherCore<M>::Identity{
        pair.topic(), pair.words(), 0, generation, Pair::first(), pair.offered, 64, 0, 0});
    Freed environment;
    const auto publish = [&](std::uint64_t address, std::uint64_t stamp_ns) {
      ASSERT_EQ(
          publisher->publish({*environment.live.insert(address).first, 16, stamp_ns}, environment),
          PublishOutcome::published);
    };
    LinkCore<M> link = pair.link(0);
    ASSERT_TRUE(link.link(true));
    publish(0x100000, 10);
    publish(0x100010, 20);
    const std::uint64_t head = link.look();
    publish(0x100020, 30);
    int passed = 0;
    while (link.pass_over_older(head, 25)) ++passed;
    EXPECT_EQ(passed, keeps_one ? 1 : 2);
    EXPECT_EQ(link.lost(), keeps_one ? 1u : 0u) << "beyond the depth";
    EXPECT_EQ(link.unread(), 1u);
    EXPECT_FALSE(link.pass_over_older(link.look(), 30)) << "it is not older";
    EXPECT_TRUE(link.pass_over_older(link.look(), 31));
    EXPECT_EQ(link.unread(), 0u);
    EXPECT_FALSE(link.pass_over_older(link.look(), 31)) << "there is none";
  }
}

TEST(Matching, WordsKeepEveryPolicy) {
  const abi::Qos qos{0x1234, true, false, true, true, true, 1, abi::qos_time_max_ns, 3};
  const abi::QosWords words = abi::pack_qos(qos);
  EXPECT_EQ(words.policies & ~abi::policy_bits, 0u);
  const abi::Qos back = abi::unpack_qos(words);
  EXPECT_EQ(back.depth, 0x1234u);
  EXPECT_TRUE(back.transient_local && back.keep_all && back.ignore_local && back.manual_liveliness);
  EXPECT_FALSE(back.reliable);
  EXPECT_EQ(back.deadline_ns, 1u);
  EXPECT_EQ(back.lifespan_ns, abi::qos_time_max_ns);
  EXPECT_EQ(back.lease_ns, 3u);
}

}  // namespace
}  // namespace agnocast::dataplane
