// SPDX-License-Identifier: Apache-2.0
//
// Runs inside the machine of systemd_test.sh: our units, real clients, kill -9, a hang, restart,
// stop and other programs.
//
// Some tests speak the protocol themselves, so that they control the time of each step; the others
// have two ordinary nodes of two users that never stop. As the unit is installed, the daemon has
// hardly any rights here; so these tests need no further rights.

#include <tests/system/systemd_inside.hpp>

namespace agnocast::test {
namespace {

TEST(Systemd, KeepsTheIncarnationOverDeathAndRestartAndLosesItWithAStop) {
  ASSERT_TRUE(systemctl("start")) << output_of("systemctl status agnocastd");
  const WireDump first = wire_dump(socket_path);
  WireNode subscriber(socket_path);
  ASSERT_TRUE(subscriber.create_subscription("/topic", deep));
  Child publisher = publisher_child();
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('w'), '+');
  // Three of the daemon (the socket is its unit's); region and pidfd of both, an eventfd, a
  // window.
  EXPECT_TRUE(soon([] { return property("NFileDescriptorStore") == "9"; }))
      << property("NFileDescriptorStore");

  std::uint64_t published = 0;
  for (int life = 0; life < 6; ++life) {
    const pid_t old = main_pid();
    if (life % 2 == 0) {
      ASSERT_EQ(send(old, SIGKILL), 0);
    } else {
      ASSERT_TRUE(systemctl("restart"));
    }
    ASSERT_EQ(publisher.command('p'), '+');
    EXPECT_EQ(subscriber.take(), ++published);
    subscriber.release();
    ASSERT_TRUE(soon([&] { return is_next(old); })) << output_of("systemctl status agnocastd");
    const WireDump all = wire_dump(socket_path);
    EXPECT_EQ(all.incarnation, first.incarnation);
    EXPECT_EQ(all.processes.size(), 2u);
    EXPECT_EQ(all.daemon.counters.restarts, static_cast<std::uint64_t>(life + 1));
    EXPECT_EQ(property("NFileDescriptorStore"), "9");
  }
  EXPECT_TRUE(goes_on_with_what_was()) << property("StatusText");

  // Both at once: the process ends while no daemon runs that would notice it.
  const pid_t old = main_pid();
  {
    const DropIn none(no_start);
    ASSERT_EQ(send(old, SIGKILL), 0);
    ASSERT_TRUE(soon([] { return is_away(); }));
    publisher.end();
    // The manager still keeps all its descriptors, its pidfd too, which a manager that polls would
    // drop.
    ::usleep(500'000);
    EXPECT_EQ(property("NFileDescriptorStore"), "9");
    ASSERT_TRUE(is_away()) << "the daemon is not away, so the test proves nothing";
  }
  ASSERT_TRUE(systemctl("restart"));
  ASSERT_TRUE(soon([&] { return is_next(old); }));
  EXPECT_TRUE(soon([&] { return wire_dump(socket_path).daemon.counters.clients_died == 1; }));
  EXPECT_TRUE(soon([] { return said("clients_lost=0") >= 7; })) << said("clients_lost=0");
  EXPECT_EQ(said("clients_lost="), said("clients_lost=0"));
  EXPECT_EQ(said("client lost"), 0u);

  ASSERT_TRUE(systemctl("stop"));
  // The count of daemons that began here stays: the next one assigns other addresses.
  EXPECT_TRUE(exists("/run/agnocast/agnocastd.sock.lock"));
  EXPECT_TRUE(socket_listens()) << "the next connection starts the daemon again";
  ASSERT_TRUE(systemctl("start"));
  const WireDump anew = wire_dump(socket_path);
  EXPECT_NE(anew.incarnation, first.incarnation);
  EXPECT_TRUE(anew.processes.empty());
  EXPECT_EQ(property("NFileDescriptorStore"), "3");
}

// As a package does it: replaces the file, then restarts the unit.
TEST(Systemd, GoesOnWithAReplacedProgramAndHarmsNothingWithOneOfAnotherLayout) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start")) << output_of("systemctl status agnocastd");
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  WireNode subscriber(socket_path);
  ASSERT_TRUE(subscriber.create_subscription("/topic", deep));
  Child publisher = publisher_child();
  ASSERT_TRUE(subscriber.wait_for([&] { return subscriber.link_count() == 1; }));
  ASSERT_EQ(publisher.command('w'), '+');
  std::uint64_t published = 0;
  const auto goes_on = [&] {
    ASSERT_EQ(publisher.command('p'), '+');
    EXPECT_EQ(subscriber.take(), ++published);
    subscriber.release();
  };
  goes_on();
  std::filesystem::copy_file("/usr/bin/agnocastd", "/opt/agnocast/agnocastd");
  const auto is_whole = [&] {
    const WireDump all = wire_dump(socket_path);
    EXPECT_EQ(all.incarnation, incarnation);
    EXPECT_EQ(all.processes.size(), 2u);
    EXPECT_EQ(all.endpoints.size(), 2u);
    EXPECT_EQ(property("NFileDescriptorStore"), "9");
  };

  install("/opt/agnocast/agnocastd");
  ASSERT_TRUE(systemctl("restart"));
  EXPECT_TRUE(goes_on_with_what_was()) << property("StatusText");
  is_whole();
  goes_on();

  // It stays, so that the unit is not restarted repeatedly, and logs why it serves nobody.
  install("/opt/agnocast/agnocastd_of_another_layout");
  ASSERT_TRUE(systemctl("restart"));
  for (int life = 0; life < 2; ++life) {
    EXPECT_TRUE(soon([] {
      return property("SubState") == "running" &&
             property("StatusText").find("refusing everybody") != std::string::npos;
    })) << property("StatusText");
    EXPECT_TRUE(soon([] { return said("refusing everybody") >= 1; }));
    EXPECT_NE(output_of("journalctl -u agnocastd -o cat --no-pager | grep -F 'layout'"), "");
    EXPECT_EQ(WireClient(socket_path).hello().refused_code(), Errc::layout_mismatch);
    EXPECT_EQ(property("NFileDescriptorStore"), "9");
    goes_on();
    if (life == 0) {
      const pid_t old = main_pid();
      ASSERT_EQ(send(old, SIGKILL), 0);
      ASSERT_TRUE(soon([&] { return is_next(old); }));
    }
  }

  install("/opt/agnocast/agnocastd");
  ASSERT_TRUE(systemctl("restart"));
  EXPECT_TRUE(goes_on_with_what_was()) << property("StatusText");
  is_whole();
  goes_on();
  EXPECT_EQ(said("client lost"), 0u);
}

TEST(Systemd, LosesNoMessageOfTwoUsersOverDeathsAndRestartsUnderTraffic) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start")) << output_of("systemctl status agnocastd");
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());

  for (int life = 0; life < 6; ++life) {
    const pid_t old = main_pid();
    if (life % 2 == 0) {
      ASSERT_EQ(send(old, SIGKILL), 0);
    } else {
      ASSERT_TRUE(systemctl("restart"));
    }
    // Requested while no daemon runs, or while all processes rejoin.
    EXPECT_TRUE(creates_more(stream.publisher));
    EXPECT_TRUE(creates_more(stream.subscriber));
    ASSERT_TRUE(soon([&] { return is_next(old); })) << output_of("systemctl status agnocastd");
    EXPECT_TRUE(stream.goes_on());
    EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
  }

  ASSERT_NO_FATAL_FAILURE(stream.end());
  EXPECT_GE(stream.got.received, 6u * 50u);
  EXPECT_EQ(wire_dump(socket_path).processes.size(), 2u);
  std::printf("%llu messages over 6 lives\n", static_cast<unsigned long long>(stream.got.received));
}

// After a manager's stop everything comes back without help: the processes have sessions with the
// next daemon, and the stream has no gap.
TEST(Systemd, TwoUsersRejoinAfterAStopAndStartUnderTraffic) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start")) << output_of("systemctl status agnocastd");
  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());
  for (int life = 0; life < 4; ++life) {
    const std::uint64_t before = wire_dump(socket_path).incarnation;
    if (life % 2 == 0) {
      ASSERT_TRUE(stop_both());
      EXPECT_TRUE(stream.goes_on()) << "without a daemon";
      EXPECT_EQ(property("ActiveState"), "inactive");
      ASSERT_TRUE(systemctl("start"));
    } else {
      // The socket stays, and nodes that rejoin start the daemon.
      ASSERT_TRUE(systemctl("stop"));
      ASSERT_TRUE(soon([] { return property("ActiveState") == "active"; }));
    }
    EXPECT_NE(wire_dump(socket_path).incarnation, before);
    EXPECT_TRUE(soon([] {
      const WireDump all = wire_dump(socket_path);
      return all.processes.size() == 2 && all.endpoints.size() == 2;
    })) << "both processes joined again by themselves";
    EXPECT_TRUE(creates_more(stream.subscriber));
    EXPECT_TRUE(creates_more(stream.publisher));
    EXPECT_TRUE(stream.goes_on());
  }
  ASSERT_NO_FATAL_FAILURE(stream.end());
  std::printf("%llu messages over 4 stops\n", static_cast<unsigned long long>(stream.got.received));
}

// --- the socket

TEST(Systemd, NodesThatComeFirstStartTheDaemonAndAreServedWhenItIsUp) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start", "agnocastd.socket"));
  EXPECT_EQ(property("ActiveState"), "inactive");
  const DropIn late("ExecStartPre=/bin/sleep 2");
  UserNode subscriber(one), publisher(two);
  EXPECT_TRUE(creates(subscriber, "subscribe /first"));
  EXPECT_EQ(property("ActiveState"), "active");
  EXPECT_TRUE(creates(publisher, "publish /first"));
  EXPECT_TRUE(soon([&] { return subscriber.state().received >= 50; }));
}

TEST(Systemd, OnlyTheGroupMayConnect) {
  ASSERT_TRUE(systemctl("start"));
  struct stat entry {};
  ASSERT_EQ(::stat(socket_path, &entry), 0);
  const group* const members = ::getgrnam("agnocast");
  ASSERT_NE(members, nullptr);
  EXPECT_EQ(entry.st_gid, members->gr_gid);
  EXPECT_EQ(entry.st_mode & 07777U, 0660U);
  EXPECT_EQ(UserNode(one).ask("create /topic"), "ok");
  EXPECT_EQ(UserNode(stranger).ask("create /topic"), sentence_of(Errc::permission_denied));
}

TEST(Systemd, TheUnitOfTheSocketDecidesAndAConfigurationThatDiffersIsNamed) {
  ASSERT_TRUE(systemctl("start"));
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  std::filesystem::create_directories("/etc/agnocast");
  std::ofstream("/etc/agnocast/agnocastd.toml")
      << "[daemon]\nsocket = \"/run/other.sock\"\nsocket_mode = \"0666\"\n";
  EXPECT_EQ(said("socket is not as configured"), 0u);
  EXPECT_TRUE(systemctl("restart"));
  EXPECT_TRUE(soon([] {
    return said(
               "its path is /run/agnocast/agnocastd.sock and not /run/other.sock, its mode is "
               "0660 and not 0666") == 1;
  })) << output_of("journalctl -u agnocastd -o cat --no-pager | tail");
  std::filesystem::remove_all("/etc/agnocast");
  EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
  EXPECT_EQ(UserNode(stranger).ask("create /topic"), sentence_of(Errc::permission_denied));
  EXPECT_FALSE(exists("/run/other.sock"));
}

TEST(Systemd, ARestartOfTheSocketIsARestartOfTheDaemonUnderTraffic) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start"));
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());
  for (int life = 0; life < 3; ++life) {
    const pid_t old = main_pid();
    ASSERT_TRUE(systemctl("restart", "agnocastd.socket"));
    ASSERT_TRUE(soon([&] { return is_next(old); }));
    EXPECT_TRUE(creates_more(stream.publisher));
    EXPECT_TRUE(creates_more(stream.subscriber));
    EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
    EXPECT_FALSE(std::filesystem::is_empty("/run/agnocast/agnocastd.sock.bells"));
  }
  ASSERT_NO_FATAL_FAILURE(stream.end());
}

// There are two sockets then; the kept one has no name any more.
TEST(Systemd, ADaemonThatListenedByItselfGoesOnWithTheUnitOfASocketUnderTraffic) {
  const std::string units = "/usr/lib/systemd/system/agnocastd.";
  const std::string alone = "/run/systemd/system/agnocastd.service";
  ASSERT_TRUE(stop_both());
  std::filesystem::rename(units + "socket", units + "aside");
  // Creating a socket for a group needs rights that the daemon does not need otherwise.
  ASSERT_EQ(std::system(("grep -v 'agnocastd.socket\\|^SystemCallFilter\\|^CapabilityB' " + units +
                         "service >" + alone)
                            .c_str()),
            0);
  ASSERT_TRUE(systemctl("daemon-reload", ""));
  ASSERT_TRUE(systemctl("start"));
  EXPECT_EQ(output_of("systemctl is-active agnocastd.socket"), "inactive");
  EXPECT_EQ(property("NFileDescriptorStore"), "4") << "with the socket";
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  Stream stream;
  EXPECT_NO_FATAL_FAILURE(stream.begin());

  std::filesystem::rename(units + "aside", units + "socket");
  std::filesystem::remove(alone);
  const int kept = std::atoi(property("NFileDescriptorStore").c_str());
  ASSERT_TRUE(systemctl("daemon-reload", ""));
  ASSERT_TRUE(systemctl("restart"));
  EXPECT_TRUE(socket_listens());
  EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
  EXPECT_TRUE(soon([&] { return property("NFileDescriptorStore") == std::to_string(kept - 1); }));
  EXPECT_TRUE(creates_more(stream.publisher));
  EXPECT_TRUE(creates_more(stream.subscriber));
  ASSERT_NO_FATAL_FAILURE(stream.end());
}

TEST(Systemd, LeavesNothingButTheLockWhenServiceAndSocketAreStopped) {
  ASSERT_TRUE(systemctl("start"));
  UserNode node(one);
  EXPECT_EQ(node.ask("subscribe /topic"), "ok");
  EXPECT_FALSE(std::filesystem::is_empty("/run/agnocast/agnocastd.sock.bells"));
  ASSERT_TRUE(stop_both());
  EXPECT_EQ(output_of("ls -A /run/agnocast"), "agnocastd.sock.lock");
  EXPECT_EQ(output_of("stat -c %a /run/agnocast/agnocastd.sock.lock"), "600");
  EXPECT_EQ(property("NFileDescriptorStore"), "0");
  ASSERT_TRUE(systemctl("start"));
  EXPECT_TRUE(soon([] { return wire_dump(socket_path).processes.size() == 1; }));
}

// A node that rejoins connects to the socket, which would start the daemon; its unit limits how
// fast.
TEST(Systemd, ConnectionsDoNotRestartADyingDaemonFasterThanItsUnitAllows) {
  ASSERT_TRUE(systemctl("start"));
  UserNode node(one);
  EXPECT_EQ(node.ask("subscribe /topic"), "ok");
  const pid_t old = main_pid();
  {
    const DropIn none(no_start);
    ASSERT_EQ(send(old, SIGKILL), 0);
    ASSERT_TRUE(soon([] { return is_away(); }));
    const WireClient waits(socket_path);
    ::usleep(1'000'000);
    EXPECT_TRUE(is_away());
  }
  ASSERT_TRUE(systemctl("restart"));
  ASSERT_TRUE(soon([&] { return is_next(old); }));
  EXPECT_TRUE(creates_more(node));
}

// A socket unit has limits of its own, after which it would be closed.
TEST(Systemd, DiesAndFailsToStartAgainAndAgainUnderTrafficAndTheSocketStays) {
  ASSERT_TRUE(stop_both());
  ASSERT_TRUE(systemctl("start"));
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());
  {
    const DropIn fast("RestartSec=0");
    for (int life = 0; life < 10; ++life) {
      const pid_t old = main_pid();
      ASSERT_EQ(send(old, SIGKILL), 0);
      ASSERT_TRUE(soon([&] { return is_another(main_pid(), old); }));
    }
  }
  {
    const DropIn broken("RestartSec=20ms\nExecStartPre=/bin/false");
    const auto restarts = [] { return std::atoi(property("NRestarts").c_str()); };
    const int before = restarts();
    ASSERT_EQ(send(main_pid(), SIGKILL), 0);
    EXPECT_TRUE(soon([&] { return restarts() >= before + 30; })) << restarts() - before;
  }
  EXPECT_TRUE(soon([] { return property("SubState") == "running"; }));
  EXPECT_TRUE(socket_listens());
  EXPECT_TRUE(creates_more(stream.publisher));
  EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
  ASSERT_NO_FATAL_FAILURE(stream.end());
}

// --- the watchdog

TEST(Systemd, ADaemonThatHangsIsEndedAndGoesOnUnderTrafficAndOneThatIsIdleIsNot) {
  ASSERT_TRUE(stop_both());
  const DropIn impatient("WatchdogSec=10s");
  ASSERT_TRUE(systemctl("start"));
  const std::uint64_t incarnation = wire_dump(socket_path).incarnation;
  const pid_t idle = main_pid();
  std::string last;
  for (int sign = 0; sign < 4; ++sign) {  // two intervals
    ASSERT_TRUE(soon([&] { return property("WatchdogTimestampMonotonic") != last; }));
    last = property("WatchdogTimestampMonotonic");
  }
  EXPECT_EQ(main_pid(), idle);

  Stream stream;
  ASSERT_NO_FATAL_FAILURE(stream.begin());
  for (int life = 0; life < 2; ++life) {
    const pid_t old = main_pid();
    ASSERT_EQ(send(old, SIGSTOP), 0);
    ASSERT_TRUE(soon([&] { return is_next(old); })) << output_of("systemctl status agnocastd");
    EXPECT_TRUE(stream.goes_on());
    EXPECT_TRUE(creates_more(stream.publisher));
    EXPECT_EQ(wire_dump(socket_path).incarnation, incarnation);
  }
  ASSERT_NO_FATAL_FAILURE(stream.end());
}

}  // namespace
}  // namespace agnocast::test
