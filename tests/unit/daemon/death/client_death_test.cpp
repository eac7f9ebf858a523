// SPDX-License-Identifier: Apache-2.0
//
// Goal: a dead client goes through its states in one order, each step comes once, and changes that
// others make between two steps are respected. Method: a registry only; the test carries out each
// step on it, as the reaper does.

#include <daemon/death/client_death.hpp>
#include <tests/support/registry_scene.hpp>

#include <gtest/gtest.h>

#include <set>
#include <variant>
#include <vector>

namespace agnocast::daemon {
namespace {

class ClientDeathTest : public testing::Test {
 protected:
  ClientIndex dead_client() {
    const ClientIndex client = scene.process();
    scene.publisher(client, "/own");
    scene.subscription(client, "/own");
    scene.subscription(client, "/other");
    return client;
  }
  /// Applies the step to the tables, as the reaper does.
  void carry_out(ClientIndex client, const DeathStep& step) {
    if (const auto* const close = std::get_if<death::Close>(&step)) {
      registry.change_subscription(close->subscription.topic, close->subscription.index,
                                   EndpointState::dead);
    } else if (const auto* const orphan = std::get_if<death::Orphan>(&step)) {
      scene.orphan(orphan->publisher);
    } else if (const auto* const acknowledge = std::get_if<death::Acknowledge>(&step)) {
      registry.acknowledge_topic(client, acknowledge->topic);
    } else if (std::holds_alternative<death::Forget>(step)) {
      registry.client_forgotten(client);
    }
  }
  std::vector<std::size_t> run(ClientDeath& death) {
    std::vector<std::size_t> kinds;
    while (const auto step = death.next()) {
      carry_out(death.client(), *step);
      kinds.push_back(step->index());
    }
    return kinds;
  }

  test::RegistryScene scene;
  Registry& registry = scene.registry;
};

TEST_F(ClientDeathTest, GoesThroughTheStatesInOrder) {
  const ClientIndex client = dead_client(), other = scene.process();
  const EndpointRef known = scene.publisher(other, "/known");
  registry.notify(known, client);
  registry.client_died(client, journal::DeathReason::died);
  ClientDeath death(client, registry);
  EXPECT_EQ(death.state(), DeathState::closing);
  const auto kinds = run(death);
  EXPECT_EQ(death.state(), DeathState::forgotten);
  EXPECT_EQ(registry.client(client).state, ClientState::forgotten);
  EXPECT_FALSE(registry.notified_of(known).contains(number(client)));
  // Two subscriptions, one publisher, the region; three topics with one or two endpoints each; the
  // end.
  const std::size_t close = DeathStep(death::Close{}).index(),
                    orphan = DeathStep(death::Orphan{}).index(),
                    unmap = DeathStep(death::Unmap{}).index(),
                    acknowledge = DeathStep(death::Acknowledge{}).index(),
                    free = DeathStep(death::FreeUnused{}).index(),
                    forget = DeathStep(death::Forget{}).index();
  EXPECT_EQ(kinds, (std::vector{close, close, orphan, unmap, acknowledge, free, acknowledge, free,
                                free, acknowledge, free, forget}));
  EXPECT_FALSE(death.next()) << "it is over";
}

TEST_F(ClientDeathTest, DoesNotRepeatTheStepsOfAnEarlierDaemon) {
  const ClientIndex client = dead_client();
  registry.client_died(client, journal::DeathReason::died);
  {
    ClientDeath first(client, registry);
    for (int i = 0; i < 3; ++i)
      carry_out(client, *first.next());  // both subscriptions, the publisher
  }
  ClientDeath again(client, registry);
  const auto step = again.next();
  ASSERT_TRUE(step);
  EXPECT_TRUE(std::holds_alternative<death::Unmap>(*step));
}

TEST_F(ClientDeathTest, LeavesAReusedPlaceAlone) {
  const ClientIndex client = scene.process(), other = scene.process();
  const EndpointRef first = scene.subscription(client, "/a"),
                    second = scene.subscription(client, "/b");
  registry.client_died(client, journal::DeathReason::died);
  ClientDeath death(client, registry);
  carry_out(client, *death.next());
  registry.change_subscription(second.topic, second.index, EndpointState::dead);
  registry.free_subscription(second.topic, second.index);
  ASSERT_EQ(scene.subscription(other, "/b"), second) << "the place was taken meanwhile";
  const auto step = death.next();
  ASSERT_TRUE(step);
  EXPECT_TRUE(std::holds_alternative<death::Unmap>(*step));
  EXPECT_EQ(registry.subscription(second.topic, second.index).state, EndpointState::active);
  EXPECT_EQ(registry.subscription(first.topic, first.index).state, EndpointState::dead);
}

TEST_F(ClientDeathTest, UnmapsAndForgetsAProcessWithoutEndpoints) {
  const ClientIndex client = scene.process();
  registry.client_died(client, journal::DeathReason::unmapped);
  ClientDeath death(client, registry);
  EXPECT_EQ(run(death).size(), 2u) << "unmap its region, and forget it";
}

}  // namespace
}  // namespace agnocast::daemon
