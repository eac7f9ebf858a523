// SPDX-License-Identifier: Apache-2.0
//
// Goal: the daemon refuses a user that has taken all it may have with the right code and the name
// of the limit; no other user notices; and all of it comes back when its processes die.
// Method: an attacker of another user goes to the end of each quota, beside the honest pair, which
// has its own quotas; then it is killed, and the next attacker gets as much again.
// integration_daemon_limits checks the counting within one user.

#include <tests/hostile/hostile_node.hpp>
#include <tests/support/processes/lowered_limit.hpp>

#include <sys/resource.h>

#include <fstream>
#include <memory>
#include <string>
#include <thread>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

const char* const small_quotas =
    "clients = 6\npublishers = 4\nsubscriptions = 4\nwait_sets = 4\nheap_bytes = \"128MiB\"\n"
    "held_messages = 300\n";

/// Returns how often `ask` succeeds before `code`, naming `limit`.
template <class Ask>
std::uint64_t takes_all(Ask ask, const char* limit, Errc code = Errc::quota_exceeded) {
  for (std::uint64_t got = 0; got < 5000; ++got) {
    const Incoming answer = ask(got);
    if (answer.opcode() != Opcode::refused) continue;
    EXPECT_EQ(answer.refused_code(), code) << answer.refused_text();
    EXPECT_NE(answer.refused_text().find(limit), std::string::npos) << answer.refused_text();
    return got;
  }
  ADD_FAILURE() << "never refused";
  return 0;
}

/// Returns how many mappings the kernel counts for a process.
std::uint64_t mappings_of(pid_t pid) {
  std::ifstream maps("/proc/" + std::to_string(pid) + "/maps");
  std::uint64_t count = 0;
  for (std::string line; std::getline(maps, line);) ++count;
  return count;
}

/// Runs the same attack three times; each attacker gets as much as the first.
void comes_back(Stage& stage, const std::function<std::uint64_t(const std::string&)>& take,
                const std::function<void()>& beside = {}) {
  const std::size_t before = stage.daemon().descriptor_count();
  std::uint64_t first = 0;
  for (int life = 0; life < 3; ++life) {
    SCOPED_TRACE("life " + std::to_string(life));
    Attacker attacker([&](Attack& attack) {
      attack.word(0).store(take(stage.socket_path()));
      if (testing::Test::HasFailure()) return;  // its end tells the test, which waits for it
      attack.ready();
      while (attack.goes_on()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    });
    if (!attacker.wait_until_ready()) return attacker.end();
    stage.honest_is_served();
    stage.honest_goes_on();
    if (beside) beside();
    if (life == 0) first = attacker.word(0);
    EXPECT_GT(attacker.word(0), 0u);
    EXPECT_EQ(attacker.word(0), first);
    attacker.kill();
    ASSERT_TRUE(eventually([&] { return stage.daemon().descriptor_count() <= before; }));
  }
}

TEST(HostileQuotas, PublishersSubscriptionsAndWaitSetsCountForOneUserAlone) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = small_quotas});
  comes_back(stage, [&](const std::string& path) {
    HostileNode node(path);
    auto& wire = node.wire();
    const auto topic = [](std::uint64_t i) { return "/t" + std::to_string(i); };
    std::uint64_t all = takes_all([&](std::uint64_t i) { return wire.create_publisher(topic(i)); },
                                  "[quota] publishers");
    all += takes_all([&](std::uint64_t i) { return wire.open_wait_set(i); }, "[quota] wait_sets");
    all += takes_all([&](std::uint64_t i) { return wire.create_subscription(topic(i)); },
                     "[quota] subscriptions");
    EXPECT_EQ(all, 12u);
    return all;
  });
}

TEST(HostileQuotas, HeapCountsForOneUserAlone) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = small_quotas});
  comes_back(stage, [&](const std::string& path) {
    HostileNode node(path);
    return takes_all([&](std::uint64_t i) { return node.wire().open_window(i); },
                     "[quota] heap_bytes");
  });
}

TEST(HostileQuotas, HeldMessagesCountForOneUserAlone) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = small_quotas});
  comes_back(stage, [&](const std::string& path) {
    HostileNode node(path);
    EXPECT_EQ(node.wire().open_wait_set().opcode(), Opcode::wait_set_opened);
    auto greedy = WireClient::endpoint("/held", {});
    greedy.quota = 100;
    return takes_all(
        [&](std::uint64_t) { return node.wire().ask(Opcode::create_subscription, greedy); },
        "[quota] held_messages");
  });
}

TEST(HostileQuotas, ClientsAndObserversCountForOneUserAlone) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = small_quotas});
  comes_back(stage, [&](const std::string& path) {
    std::vector<std::unique_ptr<WireClient>> clients, observers;
    const std::uint64_t all = takes_all(
        [&](std::uint64_t) {
          clients.push_back(std::make_unique<WireClient>(path));
          return clients.back()->hello();
        },
        "[quota] clients");
    clients.pop_back();
    // A process that is refused as a client may still observe; those places run out as well.
    wire::Observe observe{};
    observe.fingerprint = abi::fingerprint();
    observe.header = {Opcode::observe, sizeof observe, 1};
    std::uint64_t looking = 0;
    for (; looking < 100; ++looking) {
      observers.push_back(std::make_unique<WireClient>(path));
      // Without a free place the daemon refuses before it reads a request.
      if (!observers.back()->send_bytes(std::as_bytes(std::span(&observe, 1)))) break;
      const Incoming answer = observers.back()->next();
      if (answer.opcode() == Opcode::observed) continue;
      EXPECT_EQ(answer.refused_code(), Errc::quota_exceeded) << answer.refused_text();
      break;
    }
    EXPECT_EQ(all, 6u);
    EXPECT_EQ(looking, std::uint64_t{abi::observer_count_max});
    // They stay until the attacker is killed.
    static_cast<void>(new auto(std::move(clients)));
    static_cast<void>(new auto(std::move(observers)));
    return all + looking;
  });
}

TEST(HostileQuotas, TablesOfTheDaemonHaveRoomForOthers) {
  AGNOCAST_NEEDS_TWO_USERS();
  // Without a configuration one user's maximum leaves room for the next user.
  Stage stage({.quota = ""});
  comes_back(stage, [&](const std::string& path) {
    HostileNode node(path);
    // Every topic costs the daemon a row; the honest process needs one more for each creation.
    const std::uint64_t topics = 500;
    for (std::uint64_t i = 0; i < topics; ++i)
      EXPECT_EQ(node.wire().create_publisher("/room" + std::to_string(i)).opcode(),
                Opcode::endpoint_created);
    // Takes all publishers that it may have on a topic open to everybody.
    return topics + takes_all([&](std::uint64_t) { return node.wire().create_publisher("/full"); },
                              "one user may have 192");
  });
}

TEST(HostileQuotas, NobodyTakesTheLastTopicsAlone) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = ""});
  comes_back(stage, [&](const std::string& path) {
    std::vector<std::unique_ptr<HostileNode>> nodes;
    const std::uint64_t all = takes_all(
        [&](std::uint64_t i) {
          // The region of a process has room for some hundred publishers.
          if (i % 128 == 0) nodes.push_back(std::make_unique<HostileNode>(path));
          return nodes.back()->wire().create_publisher("/last" + std::to_string(i));
        },
        "[quota] topics");
    EXPECT_EQ(all, std::uint64_t{abi::topic_count_max} / 4 * 3);
    static_cast<void>(new auto(std::move(nodes)));  // they stay until the attacker is killed
    return all;
  });
}

// Takes all that one user may have of a topic open to everybody; its owner comes afterwards.
TEST(HostileQuotas, NobodyTakesTheLastPlacesOfATopicAlone) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = ""});
  int life = 0;
  comes_back(
      stage,
      [&](const std::string& path) {
        std::vector<std::unique_ptr<HostileNode>> nodes;
        const auto takes = [&](Opcode what, const char* topic, const char* limit) {
          wire::CreateEndpoint body{};
          return takes_all(
              [&](std::uint64_t i) {
                // The region of a process has room for some hundred.
                if (i % 96 == 0) {
                  nodes.push_back(std::make_unique<HostileNode>(path));
                  nodes.back()->open_wait_set();
                  body = nodes.back()->body_like(open_topic, topic, {});
                }
                return nodes.back()->wire().ask(what, body);
              },
              limit);
        };
        const std::uint64_t publishers = takes(Opcode::create_publisher, "/published",
                                               "one user may have 192 of the 256 publishers");
        const std::uint64_t subscriptions = takes(Opcode::create_subscription, "/subscribed",
                                                  "[quota] subscriptions_per_topic is 1536");
        EXPECT_EQ(publishers, 192u);
        EXPECT_EQ(subscriptions, 1536u);
        static_cast<void>(new auto(std::move(nodes)));  // they stay until the attacker is killed
        return publishers + subscriptions;
      },
      [&] {
        const auto owner = stage.another_honest_process();
        EXPECT_EQ(owner->ask("publish_flat /published"), "ok");
        EXPECT_EQ(owner->ask("watch /subscribed"), "ok");
        ++life;
      });
  EXPECT_EQ(life, 3);
}

TEST(HostileQuotas, NobodyTakesTheLastWindowsAlone) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = ""});
  for (int life = 0; life < 2; ++life) {
    const std::size_t before = stage.daemon().descriptor_count();
    Attacker attacker([&](Attack& attack) {
      std::vector<std::unique_ptr<HostileNode>> nodes;
      attack.word(0) = takes_all(
          [&](std::uint64_t i) {
            if (i % abi::window_count_max == 0)
              nodes.push_back(std::make_unique<HostileNode>(stage.socket_path()));
            return nodes.back()->wire().open_window(i % abi::window_count_max);
          },
          "[quota] heap_bytes");
      attack.ready();
      while (attack.goes_on()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    });
    ASSERT_TRUE(attacker.wait_until_ready());
    EXPECT_EQ(attacker.word(0), 48u) << "three quarters of 4 GiB, 64 MiB each";
    {
      const auto newcomer = stage.another_honest_process();
      EXPECT_EQ(newcomer->ask("create /first" + std::to_string(life)), "ok");
    }
    stage.honest_goes_on();
    attacker.kill();
    ASSERT_TRUE(eventually([&] { return stage.daemon().descriptor_count() <= before; }));
  }
}

TEST(HostileQuotas, EndpointsCostTheDaemonNoMappings) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = ""});
  const std::uint64_t before = mappings_of(stage.daemon().pid());
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    EXPECT_EQ(node.wire().open_wait_set().opcode(), Opcode::wait_set_opened);
    for (std::uint64_t i = 0; i < 300; ++i) {
      EXPECT_EQ(node.wire().create_subscription("/maps" + std::to_string(i)).opcode(),
                Opcode::endpoint_created);
      EXPECT_EQ(node.wire().create_publisher("/maps" + std::to_string(i + 1000)).opcode(),
                Opcode::endpoint_created);
    }
    attack.ready();
    while (attack.goes_on()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  // One mapping for its region; malloc maps a few for tables.
  EXPECT_LT(mappings_of(stage.daemon().pid()), before + 50);
  stage.honest_goes_on();
  stage.honest_is_served();
  attacker.end();
}

TEST(HostileQuotas, ADaemonWithoutMemoryRefusesRequests) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = ""});
  const pid_t pid = stage.daemon().pid();
  LoweredLimit limit(pid, RLIMIT_DATA, data_bytes(pid));
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    const auto refused = [&](const Incoming& answer) {
      if (answer.opcode() == Opcode::endpoint_created) return false;
      EXPECT_EQ(answer.refused_code(), Errc::limit_reached) << answer.refused_text();
      EXPECT_EQ(answer.refused_text(), "agnocastd has no memory left");
      return true;
    };
    std::uint64_t made = 0;
    while (made < 10'000 &&
           !refused(node.wire().create_publisher("/m" + std::to_string(made % 2500))))
      ++made;
    EXPECT_LT(made, 10'000u) << "never refused";
    attack.ready();
    while (attack.goes_on()) {
      static_cast<void>(node.wire().create_publisher("/more"));
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  stage.honest_goes_on();
  EXPECT_EQ(stage.daemon().pid(), pid) << stage.daemon().log();
  attacker.kill();
  limit.lift();
  EXPECT_TRUE(
      eventually([&] { return stage.publisher().ask("create /after").rfind("ok", 0) == 0; }));
  stage.honest_is_served();
  EXPECT_EQ(stage.daemon().pid(), pid) << stage.daemon().log();
}

TEST(HostileQuotas, TheDaemonsDescriptorsComeBackWhenTheAttackerEnds) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const std::size_t before = stage.daemon().descriptor_count();
  const rlimit small{before + 30, before + 30};
  ASSERT_EQ(::prlimit(stage.daemon().pid(), RLIMIT_NOFILE, &small, nullptr), 0);
  for (int life = 0; life < 2; ++life) {
    Attacker attacker([&](Attack& attack) {
      std::vector<std::unique_ptr<WireClient>> clients;
      for (bool refused = false; !refused && clients.size() < 60;) {
        clients.push_back(std::make_unique<WireClient>(stage.socket_path()));
        wire::Hello hello{};
        hello.header = {Opcode::hello, sizeof hello, 1};
        hello.fingerprint = abi::fingerprint();
        clients.back()->send_bytes(std::as_bytes(std::span(&hello, 1)));
        const Incoming answer = clients.back()->next();
        refused = answer.opcode() == Opcode::refused;
        if (refused) {
          EXPECT_TRUE(answer.refused_code() == Errc::limit_reached ||
                      answer.refused_code() == Errc::os_failure)
              << answer.refused_text();
        }
      }
      EXPECT_LT(clients.size(), 60u);
      clients.pop_back();
      attack.ready();
      while (attack.goes_on()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    });
    ASSERT_TRUE(attacker.wait_until_ready());
    stage.honest_goes_on();
    attacker.kill();
    ASSERT_TRUE(eventually([&] { return stage.daemon().descriptor_count() <= before; }));
    stage.honest_is_served();
  }
}

}  // namespace
}  // namespace agnocast::test
