// SPDX-License-Identifier: Apache-2.0
//
// Goal: the daemon by itself revokes a process that holds more than its quota, or keeps the places
// of the dead from others; one that lost its connection has more time, and honest ones are spared.
// Method: as daemon_revoke_test.cpp.

#include <tests/integration/daemon/daemon_revoke.hpp>

namespace agnocast::test {
namespace {

TEST(DaemonRevoke, RevokesASubscriptionThatHoldsMoreThanItsQuota) {
  DaemonProcess daemon(talkative);
  WireNode publisher(daemon.socket_path());
  ASSERT_TRUE(publisher.create_publisher(topic_name, deep));
  Child honest = subscriber_child(daemon.socket_path());
  Child liar = subscriber_child(daemon.socket_path());
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 2; }));
  ASSERT_EQ(honest.command('w'), '+');
  ASSERT_EQ(liar.command('w'), '+');
  for (std::uint64_t number = 1; number <= 6; ++number) ASSERT_TRUE(publisher.publish(number));
  for (int i = 0; i < 4; ++i) ASSERT_EQ(honest.command('t'), '+');  // as many as it may
  ASSERT_EQ(liar.command('l'), '+');
  EXPECT_TRUE(daemon.wait_for_log("holds 5 messages of one publisher, its quota is 4"));
  EXPECT_EQ(liar.command('R'), '+');
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 1; }));
  EXPECT_EQ(honest.command('t'), '+') << "the honest one stays";
  const std::string log = daemon.log();
  EXPECT_EQ(log.find("client revoked"), log.rfind("client revoked"));
}

std::size_t count_of(const std::string& what, const std::string& text) {
  std::size_t count = 0;
  for (auto at = text.find(what); at != std::string::npos; at = text.find(what, at + 1)) ++count;
  return count;
}

// Starts the next process in a place that has run short. The daemon refuses it until it has
// revoked the keeper.
std::unique_ptr<Child> next_of(Child (*kind)(const std::string&), const std::string& socket,
                               char what) {
  std::unique_ptr<Child> child;
  EXPECT_TRUE(eventually([&] {
    if (WireClient(socket).hello().opcode() != wire::Opcode::welcome) return false;
    child.reset(new Child(kind(socket)));
    return child->command(what).has_value();
  }));
  return child;
}

TEST(DaemonRevoke, RevokesAStoppedProcessBeforeDeadPublishersLockTheTopic) {
  DaemonProcess daemon(talkative);
  WireNode living(daemon.socket_path());
  ASSERT_TRUE(living.create_subscription(topic_name, deep));
  Child stopped = subscriber_child(daemon.socket_path());
  ASSERT_EQ(stopped.command('t'), '-');
  ASSERT_EQ(::kill(stopped.pid(), SIGSTOP), 0);
  constexpr int lives = 300;
  static_assert(lives > abi::link_block_count, "more than the places for publishers");
  for (int life = 0; life < lives; ++life) {
    const auto publisher = next_of(publisher_child, daemon.socket_path(), 'p');
    ASSERT_TRUE(living.wait_for([&] { return living.link_count() == 1; }));
    ASSERT_EQ(living.take(), 1u);
    ASSERT_TRUE(living.release());
    publisher->end();
    ASSERT_TRUE(living.wait_for([&] { return living.orphaned().size() == 1; }));
    living.unlink_drained();
  }
  EXPECT_TRUE(daemon.wait_for_log("endpoints that are gone, the oldest a publisher of /revoked"));
  Observer observer(daemon.socket_path());
  EXPECT_TRUE(eventually([&] { return observer.processes().size() == 2; }))
      << "dead processes have places";
  const auto counters = wire_dump(daemon.socket_path()).daemon.counters;
  EXPECT_EQ(counters.clients_revoked, 1u);
  EXPECT_EQ(count_of("client revoked", daemon.log()), 1u);
  ASSERT_EQ(::kill(stopped.pid(), SIGCONT), 0);
  EXPECT_EQ(stopped.command('R'), '+');
}

TEST(DaemonRevoke, RevokesAStoppedProcessBeforeSubscriptionsOrProcessesRunShort) {
  struct Scarce {
    const char* config;
    Child (*stops)(const std::string&);
    Child (*comes_and_goes)(const std::string&);
    char what;
  };
  for (const Scarce& scarce :
       {Scarce{"[limits]\nsubscriptions_per_topic = 6\n"
               "[quota]\nsubscriptions_per_topic = \"unlimited\"\n",
               publisher_child, subscriber_child, 't'},
        Scarce{"[limits]\nclients = 8\n", subscriber_child, publisher_child, 'p'}}) {
    SCOPED_TRACE(scarce.config);
    DaemonProcess daemon({.more_config = scarce.config, .arguments = {"--log-level", "debug"}});
    Child stopped = scarce.stops(daemon.socket_path());
    ASSERT_NE(stopped.command(scarce.what == 't' ? 'p' : 't'), std::nullopt);
    ASSERT_EQ(::kill(stopped.pid(), SIGSTOP), 0);
    for (int life = 0; life < 20; ++life) {
      const auto other = next_of(scarce.comes_and_goes, daemon.socket_path(), scarce.what);
      ASSERT_FALSE(HasFailure()) << "life " << life << daemon.log();
      other->end();
    }
    EXPECT_EQ(count_of("client revoked", daemon.log()), 1u);
    ASSERT_EQ(::kill(stopped.pid(), SIGCONT), 0);
    EXPECT_EQ(stopped.command('R'), '+');
  }
}

TEST(DaemonRevoke, GivesMoreTimeToAProcessWithoutAConnectionButNotForEver) {
  DaemonProcess daemon({.more_config = "[limits]\npublishers_per_topic = 6\n"
                                       "[quota]\npublishers_per_topic = \"unlimited\"\n",
                        .arguments = {"--log-level", "debug"}});
  WireNode slow(daemon.socket_path());
  ASSERT_TRUE(slow.create_subscription(topic_name, deep));
  for (int life = 0; life < 5; ++life) {
    Child publisher = publisher_child(daemon.socket_path());
    ASSERT_EQ(publisher.command('p'), '+');
    publisher.end();
  }
  const pid_t before = daemon.pid();
  daemon.kill_worker();
  ASSERT_TRUE(daemon.wait_for_next(before));
  // More looks than any process with a connection gets.
  ::sleep(8);
  // Nor does rejoining spare it, when it gets the notices again and again and does not answer.
  int returns = 0;
  EXPECT_TRUE(eventually([&] {
    WireClient again(daemon.socket_path());
    if (again.rejoin(slow.welcome()).opcode() == wire::Opcode::rejoined) ++returns;
    ::sleep(2);
    return daemon.log().find("client revoked") != std::string::npos;
  })) << daemon.log();
  EXPECT_GT(returns, 3);
}

TEST(DaemonRevoke, SparesAProcessThatHoldsMessagesOfDeadPublishers) {
  DaemonProcess daemon({.more_config = "[limits]\npublishers_per_topic = 6\n"
                                       "[quota]\npublishers_per_topic = \"unlimited\"\n",
                        .arguments = {"--log-level", "debug"}});
  WireNode holder(daemon.socket_path());
  ASSERT_TRUE(holder.create_subscription(topic_name, deep));
  Child stopped = subscriber_child(daemon.socket_path());
  ASSERT_EQ(stopped.command('t'), '-');
  ASSERT_EQ(::kill(stopped.pid(), SIGSTOP), 0);
  for (std::size_t life = 0; life < 6; ++life) {
    Child publisher = publisher_child(daemon.socket_path());
    ASSERT_EQ(publisher.command('p'), '+');
    ASSERT_TRUE(holder.wait_for([&] { return holder.link_count() == life + 1; }));
    ASSERT_EQ(holder.take(), 1u);
    publisher.end();
    ASSERT_TRUE(holder.wait_for([&] { return holder.orphaned().size() == life + 1; }));
  }
  // The same publishers, for as long: one of the two is excused by the messages that it holds.
  ASSERT_TRUE(daemon.wait_for_log("endpoints that are gone"));
  WireNode next(daemon.socket_path());
  EXPECT_FALSE(next.create_publisher(topic_name, deep)) << "held messages are not taken away";
  EXPECT_TRUE(daemon.wait_for_log("has not unmapped 6"));
  holder.pump();
  EXPECT_EQ(holder.held_count(), 6u);
  while (holder.release()) {
  }
  holder.unlink_drained();
  EXPECT_TRUE(eventually([&] {
    return next.wire().create_publisher(topic_name, deep).opcode() ==
           wire::Opcode::endpoint_created;
  }));
  const auto counters = wire_dump(daemon.socket_path()).daemon.counters;
  EXPECT_EQ(counters.clients_revoked, 1u);
}

}  // namespace
}  // namespace agnocast::test
