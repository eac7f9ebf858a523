// SPDX-License-Identifier: Apache-2.0
//
// Goal: a subscription that nobody can ring keeps no message of a publisher beyond its depth, and
// its publisher goes on.
// Method: attackers of another user shut down their doorbells before the daemon announces them.

#include <tests/hostile/hostile_node.hpp>
#include <tests/support/processes/ctl.hpp>

#include <gmock/gmock.h>

#include <sys/resource.h>
#include <unistd.h>

#include <filesystem>
#include <iterator>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using wire::Kind;

/// More than any publisher has slots, so a publisher that keeps them all for one subscription is
/// refused.
constexpr std::uint64_t more_than_slots = abi::slot_count_max + 500;

/// Waits until `count` more messages have arrived, and none was refused.
void honest_publishes(Stage& stage, std::uint64_t count) {
  const std::uint64_t end = stage.state().published + count;
  while (stage.state().published < end && !testing::Test::HasFailure()) stage.honest_goes_on();
}

TEST(HostileMute, ASubscriptionThatNobodyCanRingKeepsNoPublisherFromItsSlots) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  Attacker attacker([&](Attack& attack) {
    HostileNode node(stage.socket_path());
    node.open_wait_set();
    node.close_doorbells();
    node.join(Kind::subscription, stream_topic, {1, false, true, false, false});
    attack.ready();
    while (attack.goes_on()) ::usleep(1000);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  honest_publishes(stage, more_than_slots);
  const std::string process =
      "(pid " + std::to_string(attacker.pid()) + ", uid " + std::to_string(hostile_uid) + ")";
  const auto ctl = [&](const std::vector<std::string>& words) {
    const CtlResult result = run_ctl(stage.socket_path(), words);
    return result.out + result.err;
  };
  EXPECT_THAT(ctl({"doctor", "-j"}),
              testing::HasSubstr(process + " finds messages of " + stream_topic));
  const std::string mute = "it has no doorbell, it finds messages only by polling";
  const std::string info = ctl({"topic", "info", "-v", stream_topic});
  EXPECT_THAT(info, testing::HasSubstr(process));
  EXPECT_THAT(info, testing::HasSubstr("Doorbell: none"));
  EXPECT_THAT(ctl({"verify"}), testing::HasSubstr(std::string("not broken, but: ") + stream_topic));
  EXPECT_THAT(ctl({"verify"}), testing::HasSubstr(process + ": mute: " + mute));
  EXPECT_EQ(run_ctl(stage.socket_path(), {"verify"}).status, 0);
  EXPECT_THAT(ctl({"verify", "--json"}),
              testing::HasSubstr("\"uid\":" + std::to_string(hostile_uid)));
  EXPECT_TRUE(eventually([&] {
    const std::string said = ctl({"journal", "-n", "4096", "--topic", stream_topic, "--process",
                                  std::to_string(attacker.pid())});
    return said.find(", uid " + std::to_string(hostile_uid) +
                     "), it finds messages only by polling") != std::string::npos;
  })) << "the flight recorder does not record it";
  attacker.end();
  stage.honest_goes_on();
}

/// State of a node that has joined the stream.
struct Reader {
  std::uint64_t received = 0, wrong = 0, lost = 0, largest_gap_ns = 0;
};
Reader read_state(SteeredProcess& node) {
  Reader state;
  std::uint64_t ignored = 0;
  std::istringstream text(node.ask("state"));
  text >> ignored >> ignored >> state.received >> state.wrong >> state.lost;
  for (int i = 0; i < 4; ++i) text >> ignored;
  text >> state.largest_gap_ns;
  return state;
}

/// Returns whether a hundred messages came one by one, not many at once every second. A busy
/// machine may need more than one look; a subscription that nobody rings never gets there.
bool is_rung(SteeredProcess& node) {
  return eventually([&] {
    EXPECT_EQ(node.ask("forget-gap"), "ok");
    const std::uint64_t before = read_state(node).received;
    Reader now;
    EXPECT_TRUE(eventually([&] { return (now = read_state(node)).received >= before + 400; }));
    return now.largest_gap_ns < 500'000'000 || testing::Test::HasFailure();
  });
}

TEST(HostileMute, DoorbellsWhoseNamesWereRemovedAreRecreatedAfterARestart) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const auto reader = stage.another_honest_process(third_uid);
  ASSERT_EQ(reader->ask("subscribe /late"), "ok");
  for (const auto& name : std::filesystem::directory_iterator(stage.socket_path() + ".bells"))
    std::filesystem::remove(name);
  ASSERT_TRUE(stage.daemon().wait_for_next(stage.daemon().kill_worker()));
  // Older publishers have doorbells that still ring; the daemon announces this one after the
  // restart.
  const auto late = stage.another_honest_process();
  ASSERT_EQ(late->ask("publish /late"), "ok");
  EXPECT_TRUE(is_rung(*reader));
  honest_publishes(stage, more_than_slots);
  const Reader end = read_state(*reader);
  EXPECT_EQ(end.wrong, 0u);
  EXPECT_EQ(end.lost, 0u);
}

std::size_t descriptor_count(pid_t pid) {
  const std::filesystem::directory_iterator all("/proc/" + std::to_string(pid) + "/fd");
  return static_cast<std::size_t>(std::distance(begin(all), end(all)));
}

// 95 subscriptions with 8 wait sets each: 855 descriptors at their publisher, whose usual limit is
// 1,024.
TEST(HostileMute, OneUserCausesAQuarterOfAPublishersDescriptorsAtMost) {
  AGNOCAST_NEEDS_TWO_USERS();
  constexpr unsigned members = 95, wait_sets = 8;
  constexpr std::size_t limit = 1024, share = limit / 4;
  // The honest processes inherit it; root in a container may not set it for another user.
  rlimit own{};
  ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &own), 0);
  const rlimit usual{limit, own.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &usual), 0);
  Stage stage({.quota = "held_messages = 100000\nsubscriptions_per_topic = \"unlimited\"\n"});
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &own), 0);
  const pid_t victim = stage.publisher().pid();
  const std::size_t before = descriptor_count(victim);
  Attacker attacker([&](Attack& attack) {
    rlimit many{};
    ::getrlimit(RLIMIT_NOFILE, &many);
    many.rlim_cur = many.rlim_max;
    ::setrlimit(RLIMIT_NOFILE, &many);
    std::vector<std::unique_ptr<HostileNode>> nodes;
    bool is_refused = false;
    for (unsigned m = 0; m < members && !is_refused; ++m) {
      nodes.push_back(std::make_unique<HostileNode>(stage.socket_path()));
      for (unsigned s = 0; s < wait_sets && !is_refused; ++s) {
        is_refused = !nodes.back()->subscribe_with_wait_set(stream_topic, s, 1);
        if (!is_refused) ++attack.word(0);
      }
    }
    attack.ready();
    while (attack.goes_on()) ::usleep(1000);
  });
  ASSERT_TRUE(attacker.wait_until_ready());
  // Fewer than all if other limits are smaller, but more than this share.
  ASSERT_GT(attacker.word(0), share + share / 4);
  for (const uid_t uid : {third_uid, honest_uid}) {
    const auto reader = stage.another_honest_process(uid);
    ASSERT_EQ(reader->ask(std::string("join ") + stream_topic), "ok");
    EXPECT_TRUE(is_rung(*reader)) << "uid " << uid;
    // The daemon announced it after all of the attacker's subscriptions.
    EXPECT_LE(descriptor_count(victim), before + share + 8);
    EXPECT_GT(descriptor_count(victim), before + share / 2) << "the attacker caused no descriptors";
  }
  honest_publishes(stage, more_than_slots);
  attacker.end();
  EXPECT_TRUE(eventually([&] { return descriptor_count(victim) <= before + 8; }))
      << descriptor_count(victim) << " of " << before;
  stage.honest_goes_on();
}

}  // namespace
}  // namespace agnocast::test
