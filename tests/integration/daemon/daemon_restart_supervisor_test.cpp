// SPDX-License-Identifier: Apache-2.0
//
// Goal: the supervisor starts the installed program, however often that fails, takes orders from
// its worker alone, and keeps no more than it can hand on; a program of another layout is refused
// and harms nothing.
// Method: as daemon_restart_test.cpp; the program is replaced as an installation does it.

#include <agnocast/abi/fingerprint.hpp>
#include <base/memory/mapping.hpp>
#include <tests/integration/daemon/daemon_restart.hpp>
#include <tests/support/wire/wire_client.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <linux/capability.h>
#include <sys/stat.h>
#include <sys/xattr.h>

#include <filesystem>
#include <memory>
#include <vector>

namespace agnocast::test {
namespace {

// A program of the test's own that can be replaced.
class Program {
 public:
  Program() : directory_(make_directory()) { put(AGNOCAST_TEST_DAEMON); }
  ~Program() { remove_directory(directory_); }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;
  std::string path() const { return directory_ + "/agnocastd"; }
  /// Replaces the program as an installation does: a new file under the old name.
  void put(const std::string& other) const {
    std::filesystem::copy_file(other, path() + ".new");
    std::filesystem::rename(path() + ".new", path());
  }
  static ino_t inode(const std::string& path) {
    struct stat file {};
    return ::stat(path.c_str(), &file) == 0 ? file.st_ino : 0;
  }

 private:
  std::string directory_;
};

// The daemon refuses a process that would not survive its restart, instead of losing it at the
// restart.
TEST(DaemonRestart, KeepsNoMoreThanItsLimitOfOpenFilesCanHandOn) {
  const std::string directory = make_directory();
  const std::string program = directory + "/agnocastd";
  std::ofstream(program) << "#!/bin/sh\nulimit -n 200\nexec " AGNOCAST_TEST_DAEMON " \"$@\"\n";
  std::filesystem::permissions(program, std::filesystem::perms::owner_all);
  {
    DaemonProcess daemon({.program = program});
    std::vector<std::unique_ptr<WireClient>> clients;
    std::vector<Incoming> welcomes;  // with the regions, without which no process has a session
    Errc refused = Errc::ok;
    while (refused == Errc::ok && clients.size() < 50) {
      clients.push_back(std::make_unique<WireClient>(daemon.socket_path()));
      welcomes.push_back(clients.back()->hello());
      refused = welcomes.back().refused_code();
      for (std::uint64_t w = 0; refused == Errc::ok && w < abi::window_count_max; ++w)
        refused = clients.back()->open_window(w).refused_code();
    }
    EXPECT_EQ(refused, Errc::quota_exceeded)
        << "one user's share of the descriptors that can be handed on";
    std::vector<Mapping> regions;
    for (const Incoming& welcome : welcomes) {
      if (welcome.opcode() == wire::Opcode::welcome)
        regions.push_back(
            Mapping::map(welcome.fds[1].get(), abi::page_bytes, Mapping::Access::read_write)
                .value());
    }
    restart(daemon);
    EXPECT_TRUE(daemon.wait_for_log("clients_lost=0"));
    EXPECT_EQ(daemon.log().find("descriptor was lost"), std::string::npos);
    EXPECT_EQ(wire_dump(daemon.socket_path()).processes.size(), regions.size());
  }
  remove_directory(directory);
}

// exec of such a program resets the parent-death signal that the supervisor's child has set.
TEST(DaemonRestart, DoesNotOutliveItsSupervisorWithFileCapabilitiesEither) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  Program program;
  vfs_cap_data capabilities{};
  capabilities.magic_etc = VFS_CAP_REVISION_2 | VFS_CAP_FLAGS_EFFECTIVE;
  capabilities.data[0].permitted = 1U << CAP_IPC_LOCK;
  if (::setxattr(program.path().c_str(), "security.capability", &capabilities, sizeof capabilities,
                 0) != 0)
    GTEST_SKIP() << "no file capabilities here: " << std::strerror(errno);
  DaemonProcess daemon({.uid = 65534, .program = program.path()});
  const auto worker = Pidfd::open(daemon.pid());
  ASSERT_TRUE(worker);
  ::kill(daemon.supervisor_pid(), SIGKILL);
  pollfd entry{worker->fd(), POLLIN, 0};
  EXPECT_EQ(::poll(&entry, 1, WireClient::patience_ms), 1);
}

TEST(DaemonRestart, StartsAReplacedProgramAndGoesOnWithoutOne) {
  Program program;
  DaemonProcess daemon({.program = program.path()});
  WireNode node(daemon.socket_path());
  const auto exe = [&] { return "/proc/" + std::to_string(daemon.pid()) + "/exe"; };
  const ino_t first = Program::inode(exe());
  program.put(AGNOCAST_TEST_DAEMON);
  ASSERT_NE(Program::inode(program.path()), first);
  restart(daemon, true);
  EXPECT_EQ(Program::inode(exe()), Program::inode(program.path()));
  std::filesystem::remove(program.path());
  restart(daemon);
  EXPECT_EQ(Program::inode(exe()), first) << "the supervisor's own program";
  const WireDump all = wire_dump(daemon.socket_path());
  EXPECT_EQ(all.incarnation, node.welcome().incarnation);
  EXPECT_EQ(all.processes.size(), 1u);
}

TEST(DaemonRestart, IsRetriedWhenItFailsAndContinuesOnceItCan) {
  Program program;
  DaemonProcess daemon({.program = program.path()});
  WireNode node(daemon.socket_path());
  const pid_t old = daemon.pid();
  program.put("/bin/false");
  daemon.kill_worker();
  EXPECT_TRUE(daemon.wait_for_log("failures=3"));
  EXPECT_TRUE(daemon.is_running()) << "its store cannot be recovered";
  program.put(AGNOCAST_TEST_DAEMON);
  ASSERT_TRUE(daemon.wait_for_next(old));
  EXPECT_EQ(wire_dump(daemon.socket_path()).incarnation, node.welcome().incarnation);
}

TEST(DaemonRestart, DeathsOfReadyDaemonsDoNotLengthenThePause) {
  Program program;
  DaemonProcess daemon({.program = program.path()});
  for (int death = 1; death <= 10; ++death) {
    const pid_t old = daemon.kill_worker();
    ASSERT_TRUE(daemon.wait_for_next(old)) << death;
  }
  const pid_t old = daemon.pid();
  program.put("/bin/false");
  daemon.kill_worker();
  ASSERT_TRUE(daemon.wait_for_log("failures=13"));
  EXPECT_EQ(daemon.log().find("again_in_ms=5000"), std::string::npos) << daemon.log();
  program.put(AGNOCAST_TEST_DAEMON);
  EXPECT_TRUE(daemon.wait_for_next(old));
}

// A configuration like the usual one.
DaemonOptions watched(const std::string& seconds) {
  return {
      .config =
          "[daemon]\nsocket_mode = \"0666\"\nwatchdog_seconds = " + seconds +
          "\n[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"64GiB\"\n" AGNOCAST_TEST_ARENA_BASE};
}

// A stopped worker answers nothing, not even signals.
TEST(DaemonRestart, AHangingWorkerDelaysNeitherARestartNorTheEnd) {
  DaemonProcess daemon;
  Pair pair(daemon);
  const std::uint64_t incarnation = wire_dump(daemon.socket_path()).incarnation;
  for (int round = 0; round < 2; ++round) {
    const pid_t old = daemon.kill_worker(SIGSTOP);
    ::kill(daemon.supervisor_pid(), SIGHUP);
    ASSERT_TRUE(daemon.wait_for_next(old)) << daemon.log();
    pair.exchange();
    EXPECT_EQ(wire_dump(daemon.socket_path()).incarnation, incarnation);
  }
  EXPECT_TRUE(daemon.wait_for_log("worker killed"));
  const auto worker = Pidfd::open(daemon.kill_worker(SIGSTOP));
  ASSERT_TRUE(worker);
  EXPECT_EQ(daemon.stop(SIGTERM), 1);
  EXPECT_TRUE(worker->ended());
}

TEST(DaemonRestart, AHangingWorkerIsReplacedWithoutAnOrder) {
  DaemonProcess daemon(watched("4"));
  Pair pair(daemon);
  const std::uint64_t incarnation = wire_dump(daemon.socket_path()).incarnation;
  const pid_t idle = daemon.pid();
  // Longer than it may be silent. A wait for a processor does not count.
  ::usleep(6'000'000);
  EXPECT_EQ(daemon.pid(), idle) << daemon.log();
  daemon.kill_worker(SIGSTOP);
  ASSERT_TRUE(daemon.wait_for_next(idle)) << daemon.log();
  EXPECT_TRUE(daemon.wait_for_log("its loop does not run"));
  pair.exchange();
  EXPECT_EQ(wire_dump(daemon.socket_path()).incarnation, incarnation);
}

// To the kernel it is as ready to run as one that has no processor, which is given time.
TEST(DaemonRestart, ASpinningWorkerIsReplacedWithoutAnOrder) {
  if (std::system("/usr/bin/python3 -c 'import socket'") != 0) GTEST_SKIP() << "no python3";
  Program program;
  DaemonOptions options = watched("2");
  options.program = program.path();
  DaemonProcess daemon(options);
  const std::string spins = daemon.directory() + "/spins";
  std::ofstream(spins) << "#!/usr/bin/python3\n"
                          "import os, socket\n"
                          "notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)\n"
                          "notify.sendto(b'READY=1', os.environ['NOTIFY_SOCKET'])\n"
                          "while True: pass\n";
  std::filesystem::permissions(spins, std::filesystem::perms::owner_all);
  program.put(spins);
  const pid_t old = daemon.kill_worker();
  EXPECT_TRUE(daemon.wait_for_log("its loop does not run") ||
              daemon.wait_for_log("its loop does not run"))
      << daemon.log();
  program.put(AGNOCAST_TEST_DAEMON);
  EXPECT_TRUE(daemon.wait_for_next(old)) << daemon.log();
}

TEST(DaemonRestart, AHangingWorkerStaysWhereTheWatchdogIsSwitchedOff) {
  DaemonProcess daemon(watched("\"off\""));
  std::ifstream file("/proc/" + std::to_string(daemon.pid()) + "/environ", std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  EXPECT_EQ(text.str().find("WATCHDOG"), std::string::npos);
}

TEST(DaemonRestart, RefusesTheTablesOfAnotherBuildAndHarmsNothing) {
  Program program;
  DaemonProcess daemon({.program = program.path()});
  Pair pair(daemon);
  const WireDump before = wire_dump(daemon.socket_path());
  const std::size_t kept = daemon.kept_count();

  program.put(AGNOCAST_TEST_OTHER_DAEMON);
  ::kill(daemon.supervisor_pid(), SIGHUP);
  ASSERT_TRUE(daemon.wait_for_log("refusing everybody"));
  char own[32];
  std::snprintf(own, sizeof own, "0x%016llx", static_cast<unsigned long long>(abi::fingerprint()));
  for (int again = 0; again < 2; ++again) {
    WireClient client(daemon.socket_path());
    const Incoming hello = client.hello();
    EXPECT_EQ(hello.refused_code(), Errc::layout_mismatch);
    EXPECT_NE(hello.refused_text().find(own), std::string::npos) << hello.refused_text();
    EXPECT_NE(hello.refused_text().find("this agnocastd has layout 0x"), std::string::npos);
    wire::Rejoin rejoin{};
    // layout_mismatch would be final: the process would not rejoin the previous build.
    EXPECT_EQ(client.ask(wire::Opcode::rejoin, rejoin).refused_code(), Errc::daemon_not_running);
    wire::Observe observe{};
    EXPECT_EQ(client.ask(wire::Opcode::observe, observe).refused_code(), Errc::layout_mismatch);
    const pid_t old = daemon.kill_worker();  // it may die as often as it likes
    ASSERT_TRUE(eventually([&] { return daemon.pid() > 0 && daemon.pid() != old; }));
  }
  pair.exchange();
  // The supervisor has more open while it starts a worker.
  EXPECT_TRUE(eventually([&] { return daemon.kept_count() == kept; })) << daemon.kept_count();

  const pid_t refusing = daemon.pid();
  program.put(AGNOCAST_TEST_DAEMON);
  ::kill(daemon.supervisor_pid(), SIGHUP);
  ASSERT_TRUE(daemon.wait_for_next(refusing)) << daemon.log();
  const WireDump after = wire_dump(daemon.socket_path());
  EXPECT_EQ(after.incarnation, before.incarnation);
  EXPECT_EQ(after.processes.size(), 2u);
  EXPECT_EQ(after.endpoints.size(), 2u);
  EXPECT_EQ(daemon.kept_count(), kept);
}

TEST(DaemonRestart, TakesOrdersFromItsWorkerAlone) {
  DaemonProcess daemon;
  const std::size_t kept = daemon.kept_count();
  sockaddr_un address = address_of_supervisor(daemon);
  const UniqueFd socket(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  for (const char* order : {"FDSTOREREMOVE=1\nFDNAME=board", "FDSTORE=1\nFDNAME=mine", "x"}) {
    ASSERT_EQ(::sendto(socket.get(), order, std::strlen(order), 0,
                       reinterpret_cast<sockaddr*>(&address), sizeof address),
              static_cast<ssize_t>(std::strlen(order)))
        << std::strerror(errno);
  }
  EXPECT_TRUE(daemon.wait_for_log("notification passed over"));
  EXPECT_EQ(daemon.kept_count(), kept);
  restart(daemon);
  EXPECT_EQ(daemon.log().find("previous incarnation lost"), std::string::npos);
}

TEST(DaemonRestart, IsOneProcessWithoutAStoreIfConfigured) {
  DaemonProcess daemon({.arguments = {"--fd-store=none"}});
  EXPECT_EQ(daemon.pid(), daemon.supervisor_pid());
  std::ifstream children("/proc/" + std::to_string(daemon.pid()) + "/task/" +
                         std::to_string(daemon.pid()) + "/children");
  std::string none;
  EXPECT_FALSE(children >> none);
  EXPECT_EQ(daemon.stop(), 0);
  EXPECT_FALSE(std::filesystem::exists(daemon.socket_path()));
  const Ended alone = run_daemon({"--fd-store=manager", "--socket", "/nowhere/agnocastd.sock"});
  EXPECT_EQ(alone.status, 1);
  EXPECT_EQ(alone.err.substr(0, alone.err.find('\n')),
            "agnocastd: --fd-store=manager: no service manager is there to keep descriptors");
  EXPECT_EQ(run_daemon({"--fd-store=everybody"}).status, 2);
}

}  // namespace
}  // namespace agnocast::test
