// SPDX-License-Identifier: Apache-2.0
//
// Goal: a relay passes on nothing that lies outside the memory of the publisher whose message it was
// handed, and does not crash by it. Method: a relay of the honest user reads a stream that a rule keeps from
// others, and texts of anybody; a publisher of another user sends it texts that lie in the windows of the
// stream, nowhere, or in both in turn while they are read. What a running bridge does of it: relay_bridge_test.cpp.

#include <tests/hostile/rumors.hpp>

#include <sstream>

namespace agnocast::test {
namespace {

TEST(HostileRelay, PassesOnNothingOfAnotherPublishersMemory) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.more = "[[access]]\ntopic = \"/secret\"\nsubscribe = [\"uid:" +
                       std::to_string(honest_uid) + "\"]\n"});
  const auto secretive = stage.another_honest_process();
  SteeredProcess relay({AGNOCAST_RELAY_NODE, std::to_string(honest_uid)},
                       {"AGNOCAST_SOCKET=" + stage.socket_path()});
  ASSERT_EQ(relay.ask("read /secret"), "ok");
  ASSERT_EQ(relay.ask("relay /rumor"), "ok");
  ASSERT_EQ(secretive->ask("publish /secret"), "ok");
  std::uint64_t read = 0, relayed = 0, refused = 0, strange = 0;
  const auto look = [&] {
    std::istringstream state(relay.ask("state"));
    state >> read >> relayed >> refused >> strange;
    EXPECT_FALSE(state.fail()) << "the relay does not answer: " << state.str();
    return !state.fail();
  };
  ASSERT_TRUE(eventually([&] { return look() && read > 0; }));
  Attacker attacker([&](Attack& attack) { spread_rumors(stage.socket_path(), attack); });
  if (!attacker.wait_until_ready()) return attacker.end();
  EXPECT_TRUE(eventually([&] { return !look() || (relayed >= 20 && refused >= 200); }))
      << relayed << " relayed, " << refused << " refused";
  EXPECT_EQ(strange, 0u) << "of " << relayed << " texts that were passed on";
  attacker.end();
  const std::uint64_t before = read;
  EXPECT_TRUE(eventually([&] { return !look() || read > before; })) << "it goes on";
  std::printf("%llu texts relayed, %llu refused\n", static_cast<unsigned long long>(relayed),
              static_cast<unsigned long long>(refused));
}

}  // namespace
}  // namespace agnocast::test
