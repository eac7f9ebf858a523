// SPDX-License-Identifier: Apache-2.0
//
// Goal: the daemon may die or be restarted at any moment; the same incarnation continues, with
// every place, window, address and count, data flows meanwhile, and the daemon repairs processes
// that ended while it was away. It refuses damaged state and does not touch it.
// Method: the real supervisor and its worker; SIGKILL and SIGHUP; real client processes. To keep
// the daemon away for a while, the test stops its supervisor. Other programs, and the supervisor's
// part: daemon_restart_supervisor_test.cpp. A death at each step: daemon_restart_steps_test.cpp.

#include <agnocast/abi/fingerprint.hpp>
#include <tests/integration/daemon/daemon_restart.hpp>
#include <tests/support/memory/descriptors.hpp>
#include <tests/support/wire/listen_at.hpp>
#include <tests/support/wire/wire_client.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <fcntl.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <optional>
#include <random>
#include <span>
#include <vector>

namespace agnocast::test {
namespace {

using sweep::Child;
using sweep::serve;

TEST(DaemonRestart, ContinuesTheSameIncarnationWithItsWholeState) {
  for (const bool politely : {false, true}) {
    SCOPED_TRACE(politely ? "SIGHUP" : "SIGKILL");
    DaemonProcess daemon;
    Pair pair(daemon);
    const WireDump before = wire_dump(daemon.socket_path());
    for (int life = 0; life < 5; ++life) {
      pair.exchange();
      restart(daemon, politely);
      pair.exchange();  // nothing that the pair shares has moved
    }
    const WireDump after = wire_dump(daemon.socket_path());
    EXPECT_EQ(after.incarnation, before.incarnation);
    EXPECT_EQ(after.daemon.pid, static_cast<unsigned>(daemon.pid()));
    EXPECT_NE(after.daemon.pid, before.daemon.pid);
    EXPECT_EQ(after.daemon.windows_used, 1u);
    EXPECT_EQ(after.daemon.counters.clients_registered, 2u) << "counters belong to the incarnation";
    EXPECT_EQ(after.daemon.counters.clients_died, 0u);
    EXPECT_GE(after.daemon.uptime_ns, before.daemon.uptime_ns);
    ASSERT_EQ(after.processes.size(), 2u);
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_EQ(after.processes[i].generation, before.processes[i].generation);
      EXPECT_EQ(after.processes[i].pid, before.processes[i].pid);
      EXPECT_GE(after.processes[i].age_ns, before.processes[i].age_ns);
      EXPECT_EQ(after.processes[i].wait_sets, before.processes[i].wait_sets);
      EXPECT_EQ(after.processes[i].state, wire::ProcessState::orphaned) << "it has no connection";
      EXPECT_EQ(after.processes[i].region_count, 1u);
    }
    ASSERT_EQ(after.endpoints.size(), 2u);
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_EQ(after.endpoints[i].generation, before.endpoints[i].generation);
      EXPECT_EQ(after.endpoints[i].board_word, before.endpoints[i].board_word);
      EXPECT_EQ(after.endpoints[i].extent, before.endpoints[i].extent);
    }
    // A new process gets unused resources, and its endpoints match those present.
    WireNode late(daemon.socket_path());
    EXPECT_EQ(late.welcome().incarnation, before.incarnation);
    EXPECT_EQ(late.welcome().client, 2u);
    ASSERT_TRUE(late.create_subscription(topic_name, deep));
    EXPECT_EQ(late.subscription().index, 1u);
    ASSERT_TRUE(late.wait_for([&] { return late.link_count() == 1; }));
    EXPECT_EQ(pair.publisher.command('p'), '+');
    EXPECT_TRUE(late.take());
    WireClient other(daemon.socket_path());
    EXPECT_EQ(other.hello().opcode(), wire::Opcode::welcome);
    const auto window = other.open_window(0).as<wire::WindowOpened>();
    EXPECT_EQ(window.base, late.welcome().arena_base + window.bytes)
        << "the first window is in use";
    EXPECT_EQ(daemon.log().find(" board_words_repaired=0 ") != std::string::npos, true);
    EXPECT_EQ(daemon.log().find("client lost"), std::string::npos) << daemon.log();
    EXPECT_EQ(daemon.stop(), 0);
    EXPECT_FALSE(std::filesystem::exists(daemon.socket_path()));
    EXPECT_FALSE(std::filesystem::exists(daemon.socket_path() + ".bells"));
  }
}

TEST(DaemonRestart, LetsConnectionsWaitMeanwhileInsteadOfFail) {
  DaemonProcess daemon;
  const std::uint64_t incarnation = wire_dump(daemon.socket_path()).incarnation;
  std::optional<PacketSocket> early;
  {
    Absence away(daemon);
    auto socket = PacketSocket::connect(daemon.socket_path());
    ASSERT_TRUE(socket) << "the supervisor has the listening socket as well";
    early = std::move(*socket);
  }
  wire::Hello hello{};
  hello.header = {wire::Opcode::hello, sizeof hello, 1};
  hello.fingerprint = abi::fingerprint();
  ASSERT_TRUE(early->send(std::as_bytes(std::span(&hello, 1)), {}, Wait::yes));
  std::array<std::byte, 2048> buffer;
  const auto packet = early->receive(buffer, Wait::yes);
  ASSERT_TRUE(packet);
  wire::Welcome welcome{};
  ASSERT_EQ(packet->bytes, sizeof welcome);
  std::memcpy(static_cast<void*>(&welcome), buffer.data(), sizeof welcome);
  EXPECT_EQ(welcome.header.opcode, wire::Opcode::welcome);
  EXPECT_EQ(welcome.incarnation, incarnation);
}

TEST(DaemonRestart, RepairsProcessesThatEndedMeanwhileAndDeliversTheirCommittedMessages) {
  DaemonProcess daemon;
  const std::size_t kept = daemon.kept_count();
  WireNode subscriber(daemon.socket_path());
  ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
  Child publisher = publisher_child(daemon.socket_path());
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('w'), '+');
  Child bystander = publisher_child(daemon.socket_path(), "/elsewhere");
  ASSERT_EQ(bystander.command('p'), '+');
  subscriber.doorbells().drain();
  {
    Absence away(daemon);
    ASSERT_EQ(publisher.command('p'), '+');
    ASSERT_EQ(publisher.command('p'), '+');
    publisher.end();
    bystander.end();
  }
  const WireDump after = wire_dump(daemon.socket_path());
  EXPECT_EQ(after.daemon.counters.clients_died, 2u);
  // No peer knew the bystander: nothing of it is left. The publisher is being drained.
  ASSERT_EQ(after.processes.size(), 2u);
  EXPECT_EQ(after.process(1)->state, wire::ProcessState::dead);
  EXPECT_EQ(after.topics.size(), 1u);
  const auto orphan = std::find_if(after.endpoints.begin(), after.endpoints.end(),
                                   [](auto& e) { return e.kind == wire::Kind::publisher; });
  ASSERT_NE(orphan, after.endpoints.end());
  EXPECT_EQ(abi::state_of(orphan->board_word), abi::BoardState::orphan);
  EXPECT_EQ(subscriber.take(), 1u);
  EXPECT_EQ(subscriber.take(), 2u);
  EXPECT_EQ(subscriber.take(), std::nullopt);
  pollfd doorbell{subscriber.doorbells().datagram_fd(), POLLIN, 0};
  EXPECT_EQ(::poll(&doorbell, 1, WireClient::patience_ms), 1) << "the daemon did not ring it";
  // The subscriber's region, pidfd and eventfd; the publisher's region and window, which the
  // daemon may have to announce again to its peers; nothing of the bystander.
  EXPECT_TRUE(eventually([&] { return daemon.kept_count() == kept + 5; }))
      << daemon.kept_count() << " of " << kept;
  // The daemon gives its place to no process as long as the subscriber has it.
  WireClient next(daemon.socket_path());
  EXPECT_EQ(next.hello().as<wire::Welcome>().client, 2u);
  EXPECT_NE(next.open_window(0).as<wire::WindowOpened>().base, subscriber.welcome().arena_base);
}

TEST(DaemonRestart, LetsProcessesRejoinAndAnnouncesWhatHappenedMeanwhile) {
  for (const bool meanwhile : {false, true}) {
    SCOPED_TRACE(meanwhile ? "the publisher ends while the daemon is away" : "everybody lives");
    DaemonProcess daemon;
    WireNode subscriber(daemon.socket_path());
    ASSERT_TRUE(subscriber.create_subscription(topic_name, deep));
    const std::uint64_t creation = subscriber.wire().last_request();
    Child publisher = publisher_child(daemon.socket_path());
    ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
    ASSERT_EQ(publisher.command('w'), '+');
    {
      Absence away(daemon);
      if (meanwhile) publisher.end();
    }
    WireClient& wire = subscriber.wire();
    wire.connect_again(daemon.socket_path());
    ASSERT_EQ(wire.rejoin(subscriber.welcome()).opcode(), wire::Opcode::rejoined);
    const auto own = wire.expect<wire::Own>(wire::Opcode::own);
    EXPECT_EQ(own.generation, subscriber.subscription().generation);
    EXPECT_EQ(own.creation, creation);
    std::vector<UniqueFd> fds;
    const auto about = wire.expect<wire::Announcement>(wire::Opcode::announce, &fds);
    EXPECT_EQ(fds.size(), 2u) << "region and window, also of the dead process";
    if (meanwhile) {
      EXPECT_EQ(wire.expect<wire::Orphaned>(wire::Opcode::orphaned).generation, about.generation);
    }
    EXPECT_EQ(wire.expect<wire::Reference>(wire::Opcode::region).index, about.client);
    // The answer to a creation before the restart, and a creation after it.
    const Incoming again = wire.ask_again(wire::Opcode::create_subscription,
                                          WireClient::endpoint(topic_name, deep), creation);
    EXPECT_EQ(again.as<wire::EndpointCreated>().generation, own.generation);
    EXPECT_EQ(wire.create_subscription("/new", deep).opcode(), wire::Opcode::endpoint_created);
    EXPECT_EQ(wire_dump(daemon.socket_path()).process(0)->state, wire::ProcessState::connected);
  }
}

TEST(DaemonRestart, NoticesAProcessThatExecutedAnotherProgramMeanwhile) {
  DaemonProcess daemon;
  Child publisher(0, [&](int commands, std::uint64_t) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    WireNode node(daemon.socket_path());
    if (!node.create_publisher(topic_name, deep)) ::_exit(3);
    serve(commands, [&](char what) -> char {
      if (what == 'e') ::execlp("sleep", "sleep", "60", static_cast<char*>(nullptr));
      return '+';
    });
  });
  ASSERT_EQ(publisher.command('?'), '+');
  {
    Absence away(daemon);
    EXPECT_EQ(publisher.command('e'), std::nullopt);
  }
  EXPECT_TRUE(daemon.wait_for_log("how=\"process unmapped its region\"")) << daemon.log();
  EXPECT_TRUE(eventually([&] { return wire_dump(daemon.socket_path()).processes.empty(); }));
}

TEST(DaemonRestart, UsesNoMoreWhenProcessesDieAtRandomMoments) {
  DaemonProcess daemon;
  std::mt19937 random(17);
  const auto settled = [&] {
    return eventually([&] { return wire_dump(daemon.socket_path()).processes.empty(); });
  };
  ASSERT_TRUE(settled());
  const std::size_t kept = daemon.kept_count();
  const std::uint64_t incarnation = wire_dump(daemon.socket_path()).incarnation;
  for (int round = 0; round < 25 && !HasFailure(); ++round) {
    SCOPED_TRACE("round " + std::to_string(round));
    Child publisher = publisher_child(daemon.socket_path());
    Child subscriber = subscriber_child(daemon.socket_path());
    ASSERT_EQ(publisher.command('w'), '+');
    ASSERT_EQ(subscriber.command('w'), '+');
    ASSERT_EQ(publisher.command('p'), '+');
    const pid_t old = daemon.pid();
    // The daemon dies somewhere in the two reaps, before, or after.
    if (random() % 4 == 0) daemon.kill_worker();
    publisher.end();
    ::usleep(static_cast<useconds_t>(random() % 1500));
    if (random() % 2 == 0) subscriber.end();
    ::usleep(static_cast<useconds_t>(random() % 1500));
    if (daemon.pid() == old) daemon.kill_worker();
    subscriber.end();
    ASSERT_TRUE(daemon.wait_for_next(old)) << daemon.log();
    ASSERT_TRUE(settled()) << daemon.log();
  }
  const WireDump after = wire_dump(daemon.socket_path());
  EXPECT_EQ(after.incarnation, incarnation);
  EXPECT_EQ(after.daemon.windows_used, 0u);
  EXPECT_TRUE(after.topics.empty());
  EXPECT_EQ(after.daemon.counters.clients_registered, 50u);
  EXPECT_TRUE(eventually([&] { return daemon.kept_count() == kept; }))
      << daemon.kept_count() << " instead of " << kept;
  EXPECT_TRUE(std::filesystem::is_empty(daemon.socket_path() + ".bells"));
  EXPECT_EQ(daemon.log().find("client lost"), std::string::npos) << daemon.log();
}

TEST(DaemonRestart, FoundsANewIncarnationWhenItsStoreIsLost) {
  std::uint64_t incarnation = 0;
  std::string left, socket;
  const std::string directory = make_directory();
  {
    DaemonProcess first;
    WireNode node(first.socket_path());
    ASSERT_TRUE(node.create_subscription(topic_name, deep));
    incarnation = node.welcome().incarnation;
    first.kill();  // its supervisor; the worker dies with it
    std::filesystem::rename(first.directory() + "/run", directory + "/run");
  }
  ASSERT_FALSE(std::filesystem::is_empty(directory + "/run/agnocastd.sock.bells"));
  {
    DaemonProcess second({.socket = directory + "/run/agnocastd.sock"});
    const WireDump all = wire_dump(second.socket_path());
    EXPECT_NE(all.incarnation, incarnation);
    EXPECT_TRUE(all.processes.empty());
    EXPECT_TRUE(std::filesystem::is_empty(second.socket_path() + ".bells"));
  }
  remove_directory(directory);
}

TEST(DaemonRestart, RefusesADamagedRedoLogAndNamesTheDamage) {
  DaemonProcess daemon;
  WireNode node(daemon.socket_path());
  const UniqueFd journal = descriptor_of(daemon.supervisor_pid(), "agnocast-journal");
  ASSERT_TRUE(journal);
  const auto with = [&](off_t offset, std::uint64_t value, const char* what) {
    std::uint64_t before = 0;
    pid_t refusing = -1;
    {
      Absence away(daemon);
      ASSERT_EQ(::pread(journal.get(), &before, sizeof before, offset), ssize_t{8});
      ASSERT_EQ(::pwrite(journal.get(), &value, sizeof value, offset), ssize_t{8});
      // Not served: Absence would wait for a ready daemon in vain, so the test ends it by hand.
      ::kill(daemon.supervisor_pid(), SIGCONT);
      EXPECT_TRUE(daemon.wait_for_log(what)) << daemon.log();
      ASSERT_TRUE(eventually([&] { return daemon.pid() > 0; }));
      WireClient client(daemon.socket_path());
      const Incoming hello = client.hello();
      EXPECT_EQ(hello.refused_code(), Errc::store_damaged);
      EXPECT_NE(hello.refused_text().find(what), std::string::npos) << hello.refused_text();
      wire::Rejoin rejoin{};
      EXPECT_EQ(client.ask(wire::Opcode::rejoin, rejoin).refused_code(), Errc::daemon_not_running);
      EXPECT_TRUE(daemon.wait_for_log("code=store_damaged"));
      refusing = daemon.pid();
      ASSERT_EQ(::pwrite(journal.get(), &before, sizeof before, offset), ssize_t{8});
      daemon.kill_worker();
    }
    ASSERT_TRUE(daemon.wait_for_next(refusing));
    const WireDump all = wire_dump(daemon.socket_path());
    EXPECT_EQ(all.incarnation, node.welcome().incarnation);
    EXPECT_EQ(all.processes.size(), 1u);
  };
  with(0, 1, "the redo log has no valid header");
  with(64, 1'000, "contradict each other");
  with(64, 0, "contradict each other");
}

TEST(DaemonRestart, RecreatesItsSocketWhereItsNameWasRemoved) {
  DaemonProcess daemon;
  WireNode node(daemon.socket_path());
  std::filesystem::remove(daemon.socket_path());
  restart(daemon);
  EXPECT_EQ(wire_dump(daemon.socket_path()).incarnation, node.welcome().incarnation);
  restart(daemon);
  EXPECT_EQ(wire_dump(daemon.socket_path()).incarnation, node.welcome().incarnation);
}

// A daemon that dies right after it has recreated its socket leaves the name without a listener.
TEST(DaemonRestart, RecreatesItsSocketWhereNobodyListens) {
  DaemonProcess daemon;
  WireNode node(daemon.socket_path());
  std::filesystem::remove(daemon.socket_path());
  {
    const auto stale = test::listen_at(daemon.socket_path());
    ASSERT_TRUE(stale);
  }
  restart(daemon);
  EXPECT_EQ(wire_dump(daemon.socket_path()).incarnation, node.welcome().incarnation);
}

// It may have died after the previous socket left the store and before the new one arrived.
TEST(DaemonRestart, RecreatesSocketAndLockWhereTheyWereNotKept) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  for (const char* const lost : {"listen", "lock"}) {
    SCOPED_TRACE(lost);
    DaemonProcess daemon;
    Pair pair(daemon);
    const WireDump before = wire_dump(daemon.socket_path());
    const std::size_t kept = daemon.kept_count();
    order_as_worker(daemon, std::string("FDSTOREREMOVE=1\nFDNAME=") + lost);
    ASSERT_TRUE(eventually([&] { return daemon.kept_count() == kept - 1; }));
    restart(daemon);
    EXPECT_EQ(daemon.log().find("previous incarnation lost"), std::string::npos);
    const WireDump after = wire_dump(daemon.socket_path());
    EXPECT_EQ(after.incarnation, before.incarnation);
    EXPECT_EQ(after.processes.size(), 2u);
    EXPECT_TRUE(eventually([&] { return daemon.kept_count() == kept; })) << daemon.kept_count();
    pair.exchange();
    EXPECT_EQ(run_daemon({"--socket", daemon.socket_path(), "--fd-store=none"}).status, 1)
        << "another daemon while this one runs";
  }
}

TEST(DaemonRestart, KeepsTheArenaOfItsIncarnationWhenTheConfigurationChanges) {
  DaemonProcess daemon;
  WireNode first(daemon.socket_path());
  ASSERT_TRUE(first.create_publisher(topic_name, deep));
  std::ofstream(daemon.directory() + "/agnocastd.toml")
      << "[daemon]\nsocket_mode = \"0666\"\n[heap]\nwindow_bytes = \"128MiB\"\n"
         "arena_bytes = \"32GiB\"\n" AGNOCAST_TEST_ARENA_BASE;
  restart(daemon, true);
  WireClient next(daemon.socket_path());
  EXPECT_EQ(next.hello().as<wire::Welcome>().arena_bytes, first.welcome().arena_bytes);
  const auto another = next.open_window(0).as<wire::WindowOpened>();
  EXPECT_EQ(another.bytes, first.window().bytes);
  EXPECT_EQ(another.base, first.window().base + first.window().bytes);
}

}  // namespace
}  // namespace agnocast::test
