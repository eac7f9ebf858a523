// SPDX-License-Identifier: Apache-2.0
//
// Goal: the daemon can end the session of a living process: no other process is hurt, waits or
// loses a committed message; the process is notified, may not rejoin, and its places are used
// again only after its end. A process that lies about its holds, or keeps the places of the dead
// from others, is revoked automatically. All this outlives the daemon.
// Method: raw clients in processes of their own, SIGSTOP, and an observer that revokes; SIGKILL of
// the daemon, whose supervisor starts the next one.

#include <tests/integration/daemon/daemon_revoke.hpp>
#include <tests/support/soon.hpp>

namespace agnocast::test {
namespace {

TEST(DaemonRevoke, EndsASubscriberThatIsStoppedAndItsHoldsVanish) {
  DaemonProcess daemon(talkative);
  WireNode publisher(daemon.socket_path());  // process 0
  ASSERT_TRUE(publisher.create_publisher(topic_name, deep));
  Child subscriber = subscriber_child(daemon.socket_path());
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 1; }));
  ASSERT_EQ(subscriber.command('w'), '+');
  for (std::uint64_t number = 1; number <= 5; ++number) ASSERT_TRUE(publisher.publish(number));
  for (int i = 0; i < 3; ++i) ASSERT_EQ(subscriber.command('t'), '+');
  ASSERT_EQ(::kill(subscriber.pid(), SIGSTOP), 0);
  for (std::uint64_t number = 6; number <= 60; ++number)
    ASSERT_TRUE(publisher.publish(number)) << "it is never blocked";
  publisher.scan();
  EXPECT_EQ(publisher.allocated_count(), 13u) << "the held ones, and its depth";

  Observer observer(daemon.socket_path());
  const auto before = observer.processes();
  ASSERT_EQ(before.count(1), 1u);
  ASSERT_EQ(observer.revoke(1, before.at(1).generation).opcode(), wire::Opcode::done);
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 0; }));
  publisher.scan();
  EXPECT_EQ(publisher.allocated_count(), 0u);
  EXPECT_EQ(observer.processes().at(1).state, wire::ProcessState::revoked);
  EXPECT_EQ(observer.revoke(1, before.at(1).generation).refused_code(), Errc::endpoint_gone);

  ASSERT_EQ(::kill(subscriber.pid(), SIGCONT), 0);
  EXPECT_EQ(subscriber.command('R'), '+');
  EXPECT_EQ(subscriber.command('H'), '+') << "it may not rejoin";
  EXPECT_EQ(subscriber.command('t'), '-');
  EXPECT_TRUE(
      daemon.wait_for_log("client revoked client=1 pid=" + std::to_string(subscriber.pid())));
  EXPECT_EQ(daemon.log().find("client place free client=1"), std::string::npos);
  subscriber.end();
  EXPECT_TRUE(daemon.wait_for_log("client place free client=1"));
}

TEST(DaemonRevoke, DeliversAPublishersEarlierCommitsAndNothingAfterThem) {
  DaemonProcess daemon(talkative);
  WireNode subscriber(daemon.socket_path());  // process 0
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  Child publisher = publisher_child(daemon.socket_path());
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('w'), '+');
  for (int i = 0; i < 4; ++i) ASSERT_EQ(publisher.command('p'), '+');
  ASSERT_EQ(subscriber.take(), 1u);
  ASSERT_EQ(::kill(publisher.pid(), SIGSTOP), 0);
  Observer observer(daemon.socket_path());
  const auto revoked = observer.processes().at(1);
  ASSERT_EQ(observer.revoke(1, revoked.generation).opcode(), wire::Opcode::done);
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.orphaned().size() == 1; }));
  // It runs on and does not know yet: a core that honours the board and its readers' words. Its
  // later messages still push older messages out of a subscription's depth.
  ASSERT_EQ(::kill(publisher.pid(), SIGCONT), 0);
  for (int i = 0; i < 5; ++i) ASSERT_EQ(publisher.command('p'), '+');
  for (std::uint64_t number = 2; number <= 4; ++number) EXPECT_EQ(subscriber.take(), number);
  EXPECT_EQ(subscriber.take(), std::nullopt) << "later messages reach nobody";
  EXPECT_EQ(publisher.command('R'), '+');
  for (int i = 0; i < 50; ++i) ASSERT_EQ(publisher.command('p'), '+');
  while (subscriber.release()) {  // each is checked: it did not change while it was held
  }
  subscriber.unlink_drained();
  EXPECT_EQ(subscriber.wire().open_window(7).opcode(), wire::Opcode::refused);

  // Its index in the topic is free; it still has its place and its addresses itself.
  const auto next_place = [&] {
    Child next = publisher_child(daemon.socket_path());
    Incoming packet = subscriber.wire().next();
    EXPECT_EQ(packet.opcode(), wire::Opcode::announce);
    const auto body = packet.as<wire::Announcement>();
    subscriber.handle(std::move(packet));
    next.end();
    EXPECT_TRUE(subscriber.wait_for([&] { return subscriber.orphaned().size() == 1; }));
    subscriber.unlink_drained();
    EXPECT_EQ(subscriber.wire().open_window(7).opcode(), wire::Opcode::refused);
    return body;
  };
  const auto while_it_lives = next_place();
  EXPECT_EQ(while_it_lives.index, 0u);
  EXPECT_NE(while_it_lives.client, 1u);
  EXPECT_NE(while_it_lives.window[0].base, revoked.window[0].base);
  publisher.end();
  ASSERT_TRUE(daemon.wait_for_log("client place free client=1"));
  const auto after = next_place();
  EXPECT_EQ(after.client, 1u);
  EXPECT_EQ(after.window[0].base, revoked.window[0].base);
}

TEST(DaemonRevoke, RepairsNothingInTheRegionOfAProcessThatLives) {
  DaemonProcess daemon;
  WireNode publisher(daemon.socket_path());
  ASSERT_TRUE(publisher.create_publisher(topic_name, deep));
  ASSERT_TRUE(publisher.publish(1));
  // The state between P4 and P5: it may go on with the commit at any time.
  const auto words = publisher.queue();
  const std::uint64_t next = abi::sequence_of(words.head().load()) + 1;
  words.intent_sequence().store(next);
  words.intent_slot().store(5);
  words.intent_op().store(abi::intent_publish);
  words.slot_id(5).store(next);
  words.order(next).store(abi::pack_entry(next, 5));
  Observer observer(daemon.socket_path());
  ASSERT_EQ(observer.revoke(0, observer.processes().at(0).generation).opcode(), wire::Opcode::done);
  EXPECT_EQ(words.intent_op().load(), abi::intent_publish);
  EXPECT_EQ(words.slot_id(5).load(), next);
  EXPECT_EQ(words.order(next).load(), abi::pack_entry(next, 5));
}

TEST(DaemonRevoke, NotifiesAProcessWithAFullSocketOnceItReads) {
  DaemonProcess daemon({.more_config = "[quota]\nsubscriptions_per_topic = \"unlimited\"\n",
                        .arguments = {"--log-level", "debug"}});
  Child publisher = publisher_child(daemon.socket_path());
  ASSERT_EQ(publisher.command('x'), '?');
  ASSERT_EQ(::kill(publisher.pid(), SIGSTOP), 0);
  WireClient many(daemon.socket_path());
  many.hello();
  many.open_wait_set();
  for (int i = 0; i < 700; ++i)
    ASSERT_EQ(many.create_subscription(topic_name, deep).opcode(), wire::Opcode::endpoint_created);
  Observer observer(daemon.socket_path());
  ASSERT_EQ(observer.revoke(0, observer.processes().at(0).generation).opcode(), wire::Opcode::done);
  ASSERT_EQ(::kill(publisher.pid(), SIGCONT), 0);
  EXPECT_EQ(publisher.command('R'), '+');
}

TEST(DaemonRevoke, EndsWhenTheProcessExecutesAnotherProgramOrEnds) {
  DaemonProcess daemon(talkative);
  Observer observer(daemon.socket_path());
  Child first = publisher_child(daemon.socket_path());
  ASSERT_EQ(first.command('p'), '+');
  const auto process = observer.processes().at(0);
  ASSERT_EQ(observer.revoke(0, process.generation).opcode(), wire::Opcode::done);
  EXPECT_EQ(first.command('H'), '+');
  first.end();
  ASSERT_TRUE(daemon.wait_for_log("client place free client=0"));
  EXPECT_EQ(observer.revoke(0, process.generation).refused_code(), Errc::endpoint_gone);
  Child second = publisher_child(daemon.socket_path());
  ASSERT_EQ(second.command('p'), '+');
  EXPECT_EQ(second.command('A'), '+') << "another process is welcome";
  const auto again = observer.processes().at(0);
  EXPECT_NE(again.generation, process.generation);
  ASSERT_EQ(observer.revoke(0, again.generation).opcode(), wire::Opcode::done);
  EXPECT_EQ(second.command('e'), std::nullopt);
  EXPECT_TRUE(eventually([&] { return observer.processes().count(0) == 0; }));
  const auto counters = wire_dump(daemon.socket_path()).daemon.counters;
  EXPECT_EQ(counters.clients_revoked, 2u);
  EXPECT_EQ(counters.clients_died, 0u) << "each is counted once";
  EXPECT_EQ(counters.clients_unmapped, 1u) << "the welcome one";
}

// n nothing · d unmaps everything · m makes it slow to look at · h hello: welcome, revoked,
// connection ended.
Child forgetful_child(const std::string& socket) {
  return Child(0, [socket](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    auto node = std::make_unique<WireNode>(socket);
    serve(commands, [&](char what) -> char {
      if (what == 'd') node.reset();
      if (what == 'd' || what == 'n') return '+';
      if (what == 'm') {
        // Below the region, where the daemon looks first; the kernel would merge neighbours with
        // the same rights.
        constexpr std::size_t count = 60'000;
        const auto page = static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
        void* const all = ::mmap(nullptr, count * page, PROT_NONE,
                                 MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
        std::size_t made = 0;
        while (made < count &&
               ::mprotect(static_cast<char*>(all) + made * page, page, PROT_READ) == 0)
          made += 2;
        return answer(made > count / 2);
      }
      const auto said = greet(socket);
      if (!said) return 'e';
      return said->opcode() == wire::Opcode::welcome ? 'w' : 'r';
    });
  });
}

TEST(DaemonRevoke, IsNotReportedWithoutTimeToLookAtTheProcess) {
  DaemonProcess daemon(talkative);
  Observer observer(daemon.socket_path());
  Child slow = forgetful_child(daemon.socket_path());
  ASSERT_EQ(slow.command('m'), '+') << "vm.max_map_count is too small";
  Child other = forgetful_child(daemon.socket_path());
  ASSERT_EQ(other.command('n'), '+');
  for (const auto& [client, process] : observer.processes())
    ASSERT_EQ(observer.revoke(client, process.generation).opcode(), wire::Opcode::done);
  // The look at the slow process takes all the available time for a while.
  ASSERT_TRUE(soon([&] { return slow.command('h') == 'r'; }));
  ASSERT_EQ(other.command('d'), '+');
  std::optional<char> answer;
  ASSERT_TRUE(soon([&] {
    answer = other.command('h');
    return answer != 'e';
  }));
  EXPECT_EQ(answer, 'w') << "it has unmapped all revoked memory";
}

// --- with the daemon's death

void restart(DaemonProcess& daemon) {
  const pid_t old = daemon.kill_worker();
  ASSERT_TRUE(daemon.wait_for_next(old)) << daemon.log();
}

enum class End : std::uint8_t { later, while_away, becomes_another_program };

// Long because the three ends of the process share all steps but one.
TEST(DaemonRevoke, OutlivesTheDaemonAndThePlaceIsKeptUntilTheProcessEnds) {
  for (const End end : {End::later, End::while_away, End::becomes_another_program}) {
    SCOPED_TRACE(static_cast<int>(end));
    DaemonProcess daemon(talkative);
    std::uint64_t others = 0;  // processes that had a session and have none any more
    const auto revoke = [&](std::uint64_t client) {
      Observer observer(daemon.socket_path());
      return observer.revoke(client, observer.processes().at(client).generation).opcode();
    };
    const auto process = [&](std::uint64_t client) {
      const WireDump dump = wire_dump(daemon.socket_path());
      const wire::DaemonCounters& counters = dump.daemon.counters;
      EXPECT_EQ(counters.clients_revoked, 1u);
      EXPECT_LE(counters.clients_died + counters.clients_unmapped, others) << "counted once more";
      EXPECT_EQ(counters.clients_died_meanwhile, 0u);
      const auto* const found = dump.process(client);
      return found == nullptr ? std::optional<wire::DumpProcess>() : *found;
    };
    Child bystander = publisher_child(daemon.socket_path());  // process 0
    ASSERT_EQ(bystander.command('p'), '+');
    const std::size_t kept = daemon.kept_count();
    Child revoked = publisher_child(daemon.socket_path());
    ASSERT_EQ(revoked.command('p'), '+');
    ASSERT_EQ(revoke(1), wire::Opcode::done);
    const auto before = process(1);
    ASSERT_TRUE(before);
    EXPECT_EQ(before->state, wire::ProcessState::revoked);
    for (int life = 0; life < 3; ++life) {
      restart(daemon);
      // Longer than the daemon's interval between two looks at a process without a connection.
      ::usleep(600'000);
      const auto now = process(1);
      ASSERT_TRUE(now) << "the daemon gave its place away";
      EXPECT_EQ(now->state, wire::ProcessState::revoked);
      EXPECT_EQ(now->generation, before->generation);
      EXPECT_EQ(revoked.command('H'), '+');
      EXPECT_EQ(revoked.command('J'), '+');
      EXPECT_EQ(revoked.command('p'), '+') << "it is not disturbed in its own memory";
      {
        Child other = publisher_child(daemon.socket_path());
        ASSERT_EQ(other.command('p'), '+');
        const auto its = process(2);
        ASSERT_TRUE(its) << "the daemon gave index 1 away";
        EXPECT_NE(its->window[0].base, before->window[0].base);
        ++others;
      }
      ASSERT_TRUE(eventually([&] { return !process(2); }));
    }
    if (end == End::while_away) {
      ::kill(daemon.supervisor_pid(), SIGSTOP);
      const pid_t old = daemon.kill_worker();
      revoked.end();
      ::kill(daemon.supervisor_pid(), SIGCONT);
      ASSERT_TRUE(daemon.wait_for_next(old));
    } else if (end == End::becomes_another_program) {
      EXPECT_EQ(revoked.command('e'), std::nullopt);
    } else {
      revoked.end();
    }
    EXPECT_TRUE(eventually([&] { return !process(1); })) << "its place is not free";
    EXPECT_TRUE(eventually([&] { return daemon.kept_count() == kept; }))
        << daemon.kept_count() << " of " << kept;
    Child next = publisher_child(daemon.socket_path());
    ASSERT_EQ(next.command('p'), '+');
    const auto after = process(1);
    ASSERT_TRUE(after);
    EXPECT_EQ(after->state, wire::ProcessState::connected);
    EXPECT_EQ(after->window[0].base, before->window[0].base);
    EXPECT_EQ(daemon.log().find("client lost"), std::string::npos) << daemon.log();
  }
}

TEST(DaemonRevoke, ReachesAProcessWithoutAConnectionWhenItRejoins) {
  DaemonProcess daemon(talkative);
  WireNode publisher(daemon.socket_path());  // process 0
  ASSERT_TRUE(publisher.create_publisher(topic_name, deep));
  Child subscriber = subscriber_child(daemon.socket_path());
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 1; }));
  ASSERT_EQ(subscriber.command('w'), '+');
  for (std::uint64_t number = 1; number <= 5; ++number) ASSERT_TRUE(publisher.publish(number));
  for (int i = 0; i < 3; ++i) ASSERT_EQ(subscriber.command('t'), '+');
  ASSERT_EQ(::kill(subscriber.pid(), SIGSTOP), 0);
  restart(daemon);
  publisher.wire().connect_again(daemon.socket_path());
  ASSERT_EQ(publisher.wire().rejoin(publisher.welcome()).opcode(), wire::Opcode::rejoined);
  publisher.wire().expect<wire::Own>(wire::Opcode::own);
  publisher.wire().expect<wire::Announcement>(wire::Opcode::announce);
  publisher.wire().expect<wire::Reference>(wire::Opcode::region);

  Observer observer(daemon.socket_path());
  const auto before = observer.processes().at(1);
  EXPECT_EQ(before.state, wire::ProcessState::orphaned) << "alive, but without a connection";
  ASSERT_EQ(observer.revoke(1, before.generation).opcode(), wire::Opcode::done);
  EXPECT_EQ(observer.processes().at(1).state, wire::ProcessState::revoked);
  ASSERT_TRUE(publisher.wait_for([&] { return publisher.attached_count() == 0; }));
  publisher.scan();
  EXPECT_EQ(publisher.allocated_count(), 0u) << "its held and unread messages are free";

  // Handled before the daemon dies: all peers have acknowledged.
  EXPECT_EQ(publisher.wire().open_window(7).opcode(), wire::Opcode::refused);

  restart(daemon);  // it is not notified yet
  ASSERT_EQ(::kill(subscriber.pid(), SIGCONT), 0);
  EXPECT_EQ(subscriber.command('J'), '+');
  EXPECT_EQ(subscriber.command('H'), '+');
  EXPECT_EQ(subscriber.command('t'), '-');
  const auto state = [&] { return wire_dump(daemon.socket_path()); };
  ASSERT_NE(state().process(1), nullptr);
  EXPECT_EQ(state().process(1)->state, wire::ProcessState::revoked);
  subscriber.end();
  EXPECT_TRUE(eventually([&] { return state().process(1) == nullptr; }));
  EXPECT_EQ(state().daemon.counters.clients_revoked, 1u);
  EXPECT_EQ(state().daemon.counters.clients_died, 0u);
}

TEST(DaemonRevoke, IsForRootForTheDaemonsUserAndForTheOwner) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  DaemonProcess daemon({.config = "[daemon]\nsocket_mode = \"0666\"\n"});
  const auto become = [](uid_t uid) {
    return ::setgroups(0, nullptr) == 0 && ::setgid(uid) == 0 && ::setuid(uid) == 0;
  };
  WireNode of_root(daemon.socket_path());  // process 0
  // Process 1 is another user's.
  Child stranger(0, [&](int commands, std::uint64_t) {
    if (!become(65534)) ::_exit(9);
    WireNode node(daemon.socket_path());
    serve(commands, [&](char what) { return execute_common(node, daemon.socket_path(), what); });
  });
  ASSERT_EQ(stranger.command('x'), '?');
  const auto as = [&](uid_t uid, std::uint64_t client) {
    const pid_t pid = ::fork();
    if (pid == 0) {
      if (!become(uid)) ::_exit(9);
      Observer observer(daemon.socket_path());
      const Incoming said = observer.revoke(client, observer.processes().at(client).generation);
      ::_exit(said.opcode() == wire::Opcode::done              ? 0
              : said.refused_code() == Errc::permission_denied ? 1
                                                               : 2);
    }
    int status = 0;
    ::waitpid(pid, &status, 0);
    return WEXITSTATUS(status);
  };
  EXPECT_EQ(as(65534, 0), 1) << "another user may not";
  EXPECT_EQ(as(65533, 1), 1);
  EXPECT_EQ(as(65534, 1), 0) << "the owner may";
  EXPECT_EQ(stranger.command('R'), '+');
  EXPECT_EQ(as(0, 0), 0);
}

}  // namespace
}  // namespace agnocast::test
