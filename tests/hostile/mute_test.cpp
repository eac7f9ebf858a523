// SPDX-License-Identifier: Apache-2.0
//
// Goal: a subscription that nobody can ring keeps no message of a publisher beyond its window, and its
// publisher goes on.
// Method: attackers of another user that shut their bells before anybody is told of them.

#include <tests/hostile/hostile_node.hpp>

namespace agnocast::test {
namespace {

using wire::Kind;

/// More than any publisher has slots, so one that keeps them all for somebody is refused.
constexpr std::uint64_t more_than_slots = abi::slot_count_max + 500;

/// `count` more messages have arrived, and none was refused.
void honest_publishes(Stage& stage, std::uint64_t count) {
  const std::uint64_t end = stage.state().published + count;
  while (stage.state().published < end && !testing::Test::HasFailure()) stage.honest_goes_on();
}

TEST(HostileMute, ASubscriptionThatNobodyCanRingKeepsNoPublisherFromItsSlots) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    node.open_executor();
    node.close_bells();
    node.join(Kind::subscription, stream_topic, {1, false, true, false, false});
    attack.ready();
    while (attack.goes_on()) ::usleep(1000);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  honest_publishes(stage, more_than_slots);
  attacker.end();
  stage.honest_goes_on();
}

}  // namespace
}  // namespace agnocast::test
