// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process that may not subscribe to a topic receives no descriptor of its messages'
// memory, whatever else the publishing process does, and however often the daemon is killed or its
// rules change.
// Method: a rule lets only the honest user subscribe to /secret. Attackers of another user
// subscribe to open topics, publish to topics that the process reads, call its services, and look
// at each descriptor that they receive: the memfd's name tells whose window it is.

#include <tests/hostile/hostile_node.hpp>

#include <csignal>
#include <fstream>
#include <sstream>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

std::string only(const std::string& topic, const std::string& subscribe) {
  return "[[access]]\ntopic = \"" + topic + "\"\nsubscribe = [" + subscribe + "]\n";
}
const std::string honest = "\"uid:" + std::to_string(honest_uid) + "\"";

StageOptions with(const std::string& rules) { return {.more = rules}; }
const std::string secret_rules = only("/secret", honest) +
                                 only("/likewise", honest + ", " + honest) +
                                 only("/_service/**/vault", honest);

std::string differ() { return sentence_of(Errc::readers_differ); }

/// Returns whether it is a heap window of that user.
bool is_window_of(int fd, uid_t uid) {
  char name[96] = "";
  const std::string entry = "/proc/self/fd/" + std::to_string(fd);
  const ssize_t bytes = ::readlink(entry.c_str(), name, sizeof name - 1);
  const std::string file(name, bytes > 0 ? static_cast<std::size_t>(bytes) : 0);
  return file.find("agnocast-heap-") != std::string::npos &&
         file.find("-" + std::to_string(uid) + " ") != std::string::npos;
}

/// Reads incoming packets, and counts windows of the honest user.
void count_windows(HostileNode& node, Attack& attack) {
  while (attack.goes_on()) {
    const auto packet = node.wire().poll();
    if (!packet) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
      continue;
    }
    ++attack.word(0);
    for (const UniqueFd& fd : packet->fds) attack.word(1) += is_window_of(fd.get(), honest_uid);
  }
}

TEST(HostileSecrets, AProcessKeepsOneSetOfReaders) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage(with(secret_rules));
  const auto secretive = stage.another_honest_process();
  ASSERT_EQ(secretive->ask("create /secret"), "ok");
  EXPECT_EQ(secretive->ask("create /likewise"), "ok") << "the same user, written differently";
  EXPECT_EQ(secretive->ask("create /anything"), differ());
  const auto open = stage.another_honest_process();
  ASSERT_EQ(open->ask("create /anything"), "ok");  // destroyed at once, and the window stays
  EXPECT_EQ(open->ask("create /secret"), differ());
  const pid_t killed = stage.daemon().kill_worker();
  ASSERT_TRUE(stage.daemon().wait_for_next(killed));
  EXPECT_EQ(open->ask("create /secret"), differ());
  EXPECT_EQ(secretive->ask("create /anything"), differ());
  EXPECT_EQ(secretive->ask("create /secret"), "ok");
  EXPECT_EQ(open->ask("create /else"), "ok");
}

// A window opened after the daemon has announced the region, because it subscribes.
TEST(HostileSecrets, APublisherToAProcessReceivesNoWindowOfIt) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage(with(secret_rules));
  const auto victim = stage.another_honest_process();
  ASSERT_EQ(victim->ask("watch /bait"), "ok");
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    node.join(Kind::publisher, "/bait");
    EXPECT_EQ(node.announced().body.kind, Kind::subscription);
    attack.ready();
    count_windows(node, attack);
  });
  if (!attacker.wait_until_ready()) return attacker.end();
  ASSERT_EQ(victim->ask("publish /secret"), "ok");
  // A later announcement.
  const std::uint64_t before = attacker.word(0);
  const auto later = stage.another_honest_process();
  ASSERT_EQ(later->ask("watch /bait"), "ok");
  EXPECT_TRUE(eventually([&] { return attacker.word(0) > before; }));
  EXPECT_EQ(attacker.word(1), 0u) << "windows of the heap that /secret lies in";
  attacker.end();
}

TEST(HostileSecrets, ASubscriberToAnotherTopicReceivesNoWindowWithSecrets) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage(with(secret_rules));
  const auto victim = stage.another_honest_process();
  ASSERT_EQ(victim->ask("publish /secret"), "ok");
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    for (const char* topic : {"/secret", "/_service/request/vault"}) {
      EXPECT_EQ(node.wire().open_wait_set(topic[1] == 's' ? 0 : 1).opcode(),
                Opcode::wait_set_opened);
      EXPECT_EQ(node.wire().create_subscription(topic).refused_code(), Errc::access_denied);
    }
    attack.ready();
    count_windows(node, attack);
  });
  if (!attacker.wait_until_ready()) return attacker.end();
  EXPECT_EQ(victim->ask("create /open"), differ());
  // Requests and replies of services are messages as well; here no library of ours filters them
  // before the daemon.
  Attacker insider(
      [&](Attack& attack) {
        HostileNode node(stage.socket_path());
        const auto create = [&](const char* topic) {
          return node.wire().create_publisher(topic).refused_code();
        };
        EXPECT_EQ(create("/_service/request/vault"), Errc::ok);
        EXPECT_EQ(create("/_service/request/public"), Errc::readers_differ);
        EXPECT_EQ(create("/_service/reply/c0123456789abcdef/public"), Errc::readers_differ);
        EXPECT_EQ(create("/_service/reply/c0123456789abcdef/vault"), Errc::ok);
        attack.ready();
      },
      honest_uid);
  static_cast<void>(insider.wait_until_ready());
  insider.end();
  EXPECT_EQ(attacker.word(1), 0u);
  attacker.end();
}

/// Rewrites the configuration of the stage's daemon and lets another one begin with it.
void change_rules(Stage& stage, const std::string& from, const std::string& to) {
  const std::string file = stage.daemon().directory() + "/agnocastd.toml";
  std::ostringstream text;
  text << std::ifstream(file).rdbuf();
  std::string all = text.str();
  const std::size_t at = all.find(from);
  ASSERT_NE(at, std::string::npos);
  all.replace(at, from.size(), to);
  std::ofstream(file) << all;
  const pid_t killed = stage.daemon().kill_worker();
  ASSERT_TRUE(stage.daemon().wait_for_next(killed));
}

TEST(HostileSecrets, StricterRulesHoldForPresentProcesses) {
  AGNOCAST_NEEDS_TWO_USERS();
  const std::string loose = only("/secret", "\"*\"");
  Stage stage(with(loose));
  const auto victim = stage.another_honest_process();
  ASSERT_EQ(victim->ask("publish /secret"), "ok");
  ASSERT_EQ(victim->ask("create /public"), "ok");
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    node.join(Kind::subscription, "/secret");
    EXPECT_GT(node.announced().body.window_count, 0u);
    attack.ready();
    // The library rejoins by itself; so does this client.
    while (attack.word(2) == 0) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    node.wire().connect_again(stage.socket_path());
    const Incoming answer = node.wire().rejoin(node.welcome());
    EXPECT_EQ(answer.refused_code(), Errc::revoked) << answer.refused_text();
    EXPECT_NE(answer.refused_text().find("/secret"), std::string::npos) << answer.refused_text();
    ++attack.word(3);
  });
  if (!attacker.wait_until_ready()) return attacker.end();
  change_rules(stage, loose, only("/secret", honest));
  attacker.set_word(2, 1);
  EXPECT_TRUE(eventually([&] { return attacker.word(3) > 0; }));
  // Others have read its heap: the process creates no further topic that they may not read.
  EXPECT_TRUE(stage.daemon().wait_for_log("readers have changed topic=/secret"));
  EXPECT_EQ(victim->ask("create /likewise"), "ok") << "all users may subscribe to it, as before";
  EXPECT_EQ(victim->ask("create /secret"), differ());
  attacker.end();
  Attacker another([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    EXPECT_EQ(node.wire().open_wait_set().opcode(), Opcode::wait_set_opened);
    EXPECT_EQ(node.wire().create_subscription("/secret").refused_code(), Errc::access_denied);
    attack.ready();
  });
  static_cast<void>(another.wait_until_ready());
  another.end();
}

// An open topic is already published beside one that has become secret.
TEST(HostileSecrets, AReaderThatMayNotReadAllTopicsOfAProcessIsRefusedLater) {
  AGNOCAST_NEEDS_TWO_USERS();
  const std::string loose = only("/secret", "\"*\"");
  Stage stage(with(loose));
  const auto victim = stage.another_honest_process();
  ASSERT_EQ(victim->ask("publish /secret"), "ok");
  ASSERT_EQ(victim->ask("publish_flat /public"), "ok");
  change_rules(stage, loose, only("/secret", honest));
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    EXPECT_EQ(node.wire().open_wait_set().opcode(), Opcode::wait_set_opened);
    const Incoming refused = node.wire().create_subscription("/public");
    EXPECT_EQ(refused.refused_code(), Errc::access_denied);
    EXPECT_NE(refused.refused_text().find("/secret"), std::string::npos) << refused.refused_text();
    attack.ready();
    count_windows(node, attack);
  });
  if (!attacker.wait_until_ready()) return attacker.end();
  const auto reader = stage.another_honest_process();
  EXPECT_EQ(reader->ask("watch /public"), "ok")
      << "the reader may read all of the process's topics";
  EXPECT_EQ(attacker.word(1), 0u);
  attacker.end();
}

}  // namespace
}  // namespace agnocast::test
