// SPDX-License-Identifier: Apache-2.0
//
// Goal: a running bridge sends nothing to DDS that lies outside the memory of the publisher whose
// message it took, and does not crash on such a message. Method: the real agnocast-bridge, which a
// rule allows to read a stream that is closed to others, and a reader of Cyclone DDS on the other
// side, in its own process; a publisher of another user sends texts that lie in the windows of the
// stream, nowhere, or alternate between both while they are read.

#include <tests/hostile/rumors.hpp>
#include <tests/integration/bridge/dds/dds_domain.hpp>

#include <sstream>
#include <thread>

namespace agnocast::test {
namespace {

constexpr const char* string_type = " std_msgs::msg::dds_::String_ reliable 1000";

/// Counts of a reader in DDS so far.
struct Heard {
  std::uint64_t strings = 0, strange = 0;  // containing other letters than the expected one
};
Heard heard(SteeredProcess& peer, const std::string& topic, char letter) {
  Heard now;
  std::istringstream answer(peer.ask("letters " + topic + ' ' + letter));
  answer >> now.strings >> now.strange;
  EXPECT_FALSE(answer.fail()) << "the reader in DDS does not answer: " << answer.str();
  return now;
}

TEST(HostileRelay, TheBridgeBringsNothingOfAnotherPublishersMemoryIntoDds) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.more = "[[access]]\ntopic = \"/secret\"\nsubscribe = [\"uid:" +
                       std::to_string(honest_uid) + "\", \"uid:0\"]\n"});
  const Domain domain;
  const std::vector<std::string> environment = {"AGNOCAST_SOCKET=" + stage.socket_path(),
                                                "ROS_DOMAIN_ID=" + std::to_string(domain.id())};
  const auto node = [&] {
    return std::make_unique<SteeredProcess>(
        std::vector<std::string>{AGNOCAST_RELAY_NODE, std::to_string(honest_uid)}, environment);
  };
  const auto secretive = node(), open = node();
  ASSERT_EQ(secretive->ask("tell /secret sssssssssssssssssssssssssssssssssssssssssssssssss"), "ok");
  // Determines the topic's type.
  ASSERT_EQ(open->ask("tell /rumor"), "ok");
  const auto peer = domain.peer();
  ASSERT_EQ(peer->ask(std::string("reader rt/secret") + string_type), "made");
  ASSERT_EQ(peer->ask(std::string("reader rt/rumor") + string_type), "made");
  SteeredProcess bridge({AGNOCAST_BRIDGE, "--domain", std::to_string(domain.id())}, environment);
  ASSERT_TRUE(open->eventually("matched", "1")) << "the bridge does not read the topic";
  ASSERT_TRUE(eventually([&] { return heard(*peer, "rt/secret", 's').strings > 0; }))
      << "the bridge does not forward the stream";
  Attacker attacker(
      [&](Attack& attack) { spread_rumors(stage.socket_path(), attack, domain.id()); });
  if (!attacker.wait_until_ready()) return attacker.end();
  Heard rumors;
  const auto end = std::chrono::steady_clock::now() + patience;
  while (rumors.strings < 20 && !HasFailure() && std::chrono::steady_clock::now() < end) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    rumors = heard(*peer, "rt/rumor", 'h');
  }
  EXPECT_GE(rumors.strings, 20u) << attacker.word(lies) << " lies";
  EXPECT_EQ(rumors.strange, 0u) << "of " << rumors.strings << " texts in DDS";
  EXPECT_GE(attacker.word(lies), 100u);
  const std::uint64_t before = heard(*peer, "rt/secret", 's').strings;
  EXPECT_TRUE(eventually([&] { return heard(*peer, "rt/secret", 's').strings > before; }))
      << "a permitted reader of the stream no longer receives it";
  EXPECT_EQ(heard(*peer, "rt/secret", 's').strange, 0u);
  stage.honest_goes_on();
  attacker.end();
}

}  // namespace
}  // namespace agnocast::test
