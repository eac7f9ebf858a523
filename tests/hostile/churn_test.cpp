// SPDX-License-Identifier: Apache-2.0
//
// Goal: processes that come and go, endpoints of other types, and names full of control characters
// cost the honest pair nothing, and leave nothing behind.
// Method: for each, an attacker of another user runs for seconds beside the honest pair; in the
// end the daemon's tables hold as many processes and endpoints as before, and `verify` finds every
// invariant.

#include <tests/hostile/hostile_node.hpp>
#include <tests/support/processes/ctl.hpp>

#include <chrono>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

constexpr const char* escapes =
    "no\x1b]0;owned\x07\n\r\x9b"
    "2J\x1b[2J\x7f";

/// Returns how many processes, endpoints and windows the daemon's tables hold.
nlohmann::json counts_of(Stage& stage) {
  return run_ctl(stage.socket_path(), {"status", "-j"}).json()["in_use"];
}

/// The honest pair goes on and is served during the attack; then the attacker ends and leaves
/// nothing.
void nothing_is_left_of(Stage& stage, Attacker& attacker, const char* what) {
  if (!attacker.wait_until_ready()) return;
  const auto end = std::chrono::steady_clock::now() + attack_time();
  do {
    stage.honest_goes_on();
    stage.honest_is_served();
  } while (std::chrono::steady_clock::now() < end && !testing::Test::HasFailure());
  EXPECT_TRUE(eventually([&] { return attacker.word(0) >= 3; }));
  attacker.end();
  std::printf("%llu %s\n", static_cast<unsigned long long>(attacker.word(0)), what);
}

TEST(HostileChurn, ProcessesThatJoinAndAreKilledLeaveNothing) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  const auto before = counts_of(stage);
  {
    Attacker attacker([&](Attack& attack) {
      for (attack.ready(); attack.goes_on(); ++attack.word(0)) {
        Child child([&] {
          HostileNode node(path);
          node.join(Kind::subscription, stream_topic);
          node.join(Kind::publisher, open_topic);
          ::raise(SIGKILL);
          return 1;
        });
        EXPECT_EQ(child.wait(), -SIGKILL);
      }
    });
    nothing_is_left_of(stage, attacker, "processes joined and were killed");
  }
  EXPECT_TRUE(eventually([&] { return counts_of(stage) == before; }));
  EXPECT_EQ(run_ctl(stage.socket_path(), {"verify"}).status, 0);
}

TEST(HostileChurn, OtherTypesUnderTheRightNameMatchNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  const std::string matched = stage.publisher().ask("matched");
  Chance chance(71);
  Attacker attacker([&](Attack& attack) {
    HostileNode node(path);
    EXPECT_EQ(node.wire().open_wait_set().opcode(), Opcode::wait_set_opened);
    for (attack.ready(); attack.goes_on(); ++attack.word(0)) {
      auto body =
          WireClient::endpoint(stream_topic, {}, "wrong/msg/Type" + std::to_string(chance()));
      body.layout_hash = chance.nasty();
      EXPECT_EQ(node.wire().ask(Opcode::create_subscription, body).refused_code(),
                Errc::type_mismatch);
    }
  });
  nothing_is_left_of(stage, attacker, "wrong types were refused");
  EXPECT_EQ(stage.publisher().ask("matched"), matched);
}

// Long because the attack and the list of all commands that show names stand here.
TEST(HostileChurn, NamesFullOfControlCharactersReachNoTerminal) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::string path = stage.socket_path();
  Attacker attacker([&](Attack& attack) {
    WireClient wire(path);
    wire::Hello hello{};
    hello.fingerprint = abi::fingerprint();
    hello.process_name = wire_name(escapes);
    EXPECT_EQ(wire.ask(Opcode::hello, hello).opcode(), Opcode::welcome);
    wire::Blocked range{};
    range.base = std::uint64_t{1} << 30;
    range.bytes = 4096;
    range.what = wire_name(escapes);
    wire.send(Opcode::blocked, range);
    EXPECT_EQ(wire.open_wait_set().opcode(), Opcode::wait_set_opened);
    auto body = WireClient::endpoint(open_topic, {}, escapes);
    body.node = wire_name(escapes);
    for (int field = 0; field < 3; ++field) {
      // Refused or not, the name appears in the log, among the refusals or in the tables.
      wire.ask(Opcode::create_subscription, body);
      if (field == 0) body.type = wire_name("test/msg/Type");
      if (field == 1) body.topic = wire_name(std::string("/escapes") + escapes);
    }
    for (attack.ready(); attack.goes_on();) ::usleep(1000);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  const std::string attacker_pid = std::to_string(attacker.pid());
  unsigned escaped = 0;
  for (const std::vector<std::string>& words :
       std::vector<std::vector<std::string>>{{"topic", "list"},
                                             {"topic", "list", "-v"},
                                             {"topic", "info", "-v", open_topic},
                                             {"topic", "find", "test/msg/Type"},
                                             {"topic", "type", open_topic},
                                             {"node", "list"},
                                             {"node", "info", "/node"},
                                             {"service", "list"},
                                             {"process", "list"},
                                             {"process", "info", attacker_pid},
                                             {"heap", "list"},
                                             {"heap", "info", attacker_pid},
                                             {"message", "list"},
                                             {"status"},
                                             {"top", "-b", "-n", "1"},
                                             {"dump"},
                                             {"graph"},
                                             {"doctor"},
                                             {"journal"},
                                             {"verify"},
                                             {"access", open_topic},
                                             {"metrics"},
                                             {"bridge", "list"}}) {
    for (const bool json : {false, true}) {
      std::vector<std::string> line = words;
      if (json) line.insert(line.begin(), "--json");
      const CtlResult result = run_ctl(path, line);
      if (result.out.find("\\x1b") != std::string::npos) ++escaped;
      std::string command;
      for (const std::string& word : line) command += " " + word;
      EXPECT_GE(result.status, 0) << command << result.err;
      for (const std::string* text : {&result.out, &result.err}) {
        const auto strange = [](unsigned char c) { return (c < 32 && c != '\n') || c == 127; };
        const auto found = std::find_if(text->begin(), text->end(), strange);
        EXPECT_EQ(found, text->end()) << command << " prints control character "
                                      << static_cast<int>(*found) << " in: " << *text;
        EXPECT_EQ(text->find("\x9b"), std::string::npos) << command;
      }
    }
  }
  EXPECT_GE(escaped, 5u) << "the names did not reach the commands";
  // People read the log on terminals, too.
  EXPECT_EQ(stage.daemon().log().find('\x1b'), std::string::npos);
  stage.honest_goes_on();
  attacker.end();
}

}  // namespace
}  // namespace agnocast::test
