// SPDX-License-Identifier: Apache-2.0
//
// Goal: a relay passes on nothing that lies outside the memory of the publisher whose message it
// took, and does not crash on such a message. Method: a relay of the honest user reads a stream
// that is closed to others, and texts of all users; a publisher of another user sends it texts
// that lie in the windows of the stream, nowhere, or alternate between both while they are read.
// One relay is generic; another is typed and publishes the message itself or a checked copy, for a
// third process to judge. For a running bridge see relay_bridge_test.cpp.

#include <tests/hostile/rumors.hpp>

#include <sstream>

namespace agnocast::test {
namespace {

/// A relay node of the honest user, and its reported counts.
class Relay {
 public:
  explicit Relay(const Stage& stage)
      : node_({AGNOCAST_RELAY_NODE, std::to_string(honest_uid)},
              {"AGNOCAST_SOCKET=" + stage.socket_path()}) {}
  std::string ask(const std::string& what) { return node_.ask(what); }
  /// Returns false, with a failure, when the relay does not answer any more.
  bool look() {
    std::istringstream state(node_.ask("state"));
    state >> read >> relayed >> refused >> strange;
    EXPECT_FALSE(state.fail()) << "the relay does not answer: " << state.str();
    return !state.fail();
  }
  std::uint64_t read = 0, relayed = 0, refused = 0, strange = 0;

 private:
  SteeredProcess node_;
};

StageOptions with_a_secret() {
  return {.more = "[[access]]\ntopic = \"/secret\"\nsubscribe = [\"uid:" +
                  std::to_string(honest_uid) + "\"]\n"};
}

TEST(HostileRelay, PassesOnNoMemoryOfAnotherPublisher) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage(with_a_secret());
  const auto secretive = stage.another_honest_process();
  Relay relay(stage);
  ASSERT_EQ(relay.ask("read /secret"), "ok");
  ASSERT_EQ(relay.ask("relay /rumor"), "ok");
  ASSERT_EQ(secretive->ask("publish /secret"), "ok");
  ASSERT_TRUE(eventually([&] { return relay.look() && relay.read > 0; }));
  Attacker attacker([&](Attack& attack) { spread_rumors(stage.socket_path(), attack); });
  if (!attacker.wait_until_ready()) return attacker.end();
  EXPECT_TRUE(eventually([&] {
    return !relay.look() || (relay.relayed >= 20 && relay.refused >= 200);
  })) << relay.relayed
      << " relayed, " << relay.refused << " refused";
  EXPECT_EQ(relay.strange, 0u) << "of " << relay.relayed << " texts that were passed on";
  attacker.end();
  const std::uint64_t before = relay.read;
  EXPECT_TRUE(eventually([&] { return !relay.look() || relay.read > before; }))
      << "the relay stopped reading";
  std::printf("%llu texts relayed, %llu refused\n", static_cast<unsigned long long>(relay.relayed),
              static_cast<unsigned long long>(relay.refused));
}

class HostileTypedRelay : public testing::TestWithParam<const char*> {};

TEST_P(HostileTypedRelay, PublishesNoMemoryOfAnotherPublisher) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage(with_a_secret());
  const auto secretive = stage.another_honest_process();
  Relay relay(stage), judge(stage);
  ASSERT_EQ(judge.ask("relay /forwarded"), "ok");
  ASSERT_EQ(relay.ask("read /secret"), "ok");
  ASSERT_EQ(relay.ask(std::string(GetParam()) + " /rumor /forwarded"), "ok");
  ASSERT_EQ(secretive->ask("publish /secret"), "ok");
  ASSERT_TRUE(eventually([&] { return relay.look() && relay.read > 0; }));
  Attacker attacker([&](Attack& attack) { spread_rumors(stage.socket_path(), attack); });
  if (!attacker.wait_until_ready()) return attacker.end();
  EXPECT_TRUE(eventually([&] {
    return !relay.look() || !judge.look() || (judge.relayed >= 20 && relay.refused >= 200);
  })) << judge.relayed
      << " relayed, " << relay.refused << " refused";
  EXPECT_EQ(judge.strange, 0u) << "of " << judge.relayed << " texts that were published again";
  EXPECT_EQ(judge.refused, 0u) << "the relay published memory that is not its own";
  attacker.end();
  const std::uint64_t before = relay.read;
  EXPECT_TRUE(eventually([&] { return !relay.look() || relay.read > before; }))
      << "the relay stopped reading";
}

INSTANTIATE_TEST_SUITE_P(Each, HostileTypedRelay, testing::Values("forward", "forward_checked"),
                         [](const auto& test) { return std::string(test.param); });

}  // namespace
}  // namespace agnocast::test
