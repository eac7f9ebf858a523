// SPDX-License-Identifier: Apache-2.0
//
// Goal: the daemon may die at any step of its start, be it the first one, the formatting of an
// incarnation, or a continuation. Method: as daemon_restart_test.cpp, with a daemon that dies at
// the n-th crash point, for n = 1, 2, 3 … until it survives.

#include <daemon/state/steps.hpp>
#include <tests/integration/daemon/daemon_restart.hpp>
#include <tests/support/crash/crash_control.hpp>
#include <tests/support/machine/temporary_directory.hpp>
#include <tests/support/processes/child.hpp>
#include <tests/support/wire/wire_client.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <fcntl.h>

#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <string>

namespace agnocast::test {
namespace {

using sweep::Child;

std::size_t count_of(const std::string& text, const std::string& part) {
  std::size_t count = 0;
  for (std::size_t at = 0; (at = text.find(part, at)) != std::string::npos; ++at) ++count;
  return count;
}

/// Returns the deaths at n = 1, 2, 3 … until `life(control, n, survived)` reports that the daemon
/// survived.
template <class Life>
unsigned deaths_of(Life life) {
  unsigned deaths = 0;
  bool survived = false;
  for (std::uint64_t n = 1; !testing::Test::HasFailure(); ++n) {
    SCOPED_TRACE("step " + std::to_string(n));
    const TemporaryDirectory directory;
    CrashControl control(directory.path() + "/control");
    life(control, n, survived);
    if (survived) break;
    ++deaths;
  }
  return deaths;
}

// The daemon's work when it continues: two processes have ended, each with an endpoint that the
// other knows, and a living pair must not notice.
TEST(DaemonRestart, MayDieAtAnyStepOfItsContinuation) {
  const unsigned deaths = deaths_of([](CrashControl& control, std::uint64_t n, bool& survived) {
    DaemonProcess daemon({.program = AGNOCAST_TEST_CRASHING_DAEMON});
    Pair pair(daemon, "/living");
    Child dead_publisher = publisher_child(daemon.socket_path());
    Child dead_subscriber = subscriber_child(daemon.socket_path());
    ASSERT_EQ(dead_publisher.command('w'), '+');
    ASSERT_EQ(dead_subscriber.command('w'), '+');
    ASSERT_EQ(dead_publisher.command('p'), '+');
    {
      Absence away(daemon);
      dead_publisher.end();
      dead_subscriber.end();
      control.arm(n);
    }
    control.arm(0);  // it serves: another test sweeps serving
    const std::string log = daemon.log();
    survived = count_of(log, "worker died") == 1;
    const WireDump all = wire_dump(daemon.socket_path());
    EXPECT_EQ(all.processes.size(), 2u);
    EXPECT_EQ(all.topics.size(), 1u);
    EXPECT_EQ(all.endpoints.size(), 2u);
    EXPECT_EQ(all.daemon.windows_used, 1u);
    pair.exchange();
    EXPECT_EQ(log.find("client lost"), std::string::npos) << log;
    EXPECT_EQ(log.find("damaged"), std::string::npos) << log;
    EXPECT_EQ(std::distance(std::filesystem::directory_iterator(daemon.socket_path() + ".bells"),
                            std::filesystem::directory_iterator()),
              1);
  });
  std::printf("died at %u steps of going on\n", deaths);
  EXPECT_GT(deaths, 60u);
}

// The same with the formatting of an incarnation: the store is useless without the board, so the
// next daemon releases it and begins with nothing. Wherever that daemon dies, the one after it
// formats one incarnation, keeps exactly the descriptors of it, and serves.
TEST(DaemonRestart, MayDieAtAnyStepOfFormatting) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  const unsigned deaths = deaths_of([](CrashControl& control, std::uint64_t n, bool& survived) {
    DaemonProcess daemon({.program = AGNOCAST_TEST_CRASHING_DAEMON});
    const std::size_t kept = daemon.kept_count();
    std::set<std::uint64_t> incarnations;
    {
      WireNode before(daemon.socket_path());
      ASSERT_TRUE(before.create_subscription(topic_name, deep));
      incarnations.insert(before.welcome().incarnation);
      const std::size_t with_it = daemon.kept_count();
      order_as_worker(daemon, "FDSTOREREMOVE=1\nFDNAME=board");
      ASSERT_TRUE(eventually([&] { return daemon.kept_count() == with_it - 1; }));
      const Absence away(daemon);
      control.arm(n);
    }
    control.arm(0);
    survived = count_of(daemon.log(), "worker died") == 1;
    const WireDump all = wire_dump(daemon.socket_path());
    EXPECT_TRUE(incarnations.insert(all.incarnation).second) << "the board is a new one";
    EXPECT_TRUE(all.processes.empty());
    EXPECT_TRUE(std::filesystem::is_empty(daemon.socket_path() + ".bells"));
    EXPECT_EQ(daemon.kept_count(), kept);
    EXPECT_EQ(run_daemon({"--socket", daemon.socket_path(), "--fd-store=none"}).status, 1);
    // The incarnation can continue.
    Pair pair(daemon);
    pair.exchange();
    restart(daemon);
    EXPECT_EQ(wire_dump(daemon.socket_path()).incarnation, all.incarnation);
    pair.exchange();
    EXPECT_EQ(daemon.log().find("damaged"), std::string::npos) << daemon.log();
  });
  std::printf("died at %u steps of formatting\n", deaths);
  EXPECT_GT(deaths, 15u);
}

// Before any daemon was ready the store is empty: leftovers lie in the directory.
TEST(DaemonRestart, MayDieAtAnyStepOfTheFirstStart) {
  const unsigned deaths = deaths_of([](CrashControl& control, std::uint64_t n, bool& survived) {
    const TemporaryDirectory directory;
    const std::string socket = directory.path() + "/run/agnocastd.sock";
    {
      control.arm(n);
      test::Child first([&] {
        const UniqueFd log(::open((directory.path() + "/log").c_str(), O_WRONLY | O_CREAT, 0600));
        ::dup2(log.get(), STDERR_FILENO);
        ::execl(AGNOCAST_TEST_CRASHING_DAEMON, AGNOCAST_TEST_CRASHING_DAEMON, "--socket",
                socket.c_str(), static_cast<char*>(nullptr));
        return 127;
      });
      const auto process = Pidfd::open(first.pid());
      ASSERT_TRUE(process);
      ASSERT_TRUE(eventually([&] {
        std::ifstream file(directory.path() + "/log");
        const std::string log{std::istreambuf_iterator<char>(file), {}};
        survived = log.find(" ready ") != std::string::npos;
        return survived || process->ended();
      }));
      if (survived) {
        // The worker ends shortly after its supervisor; until then it has the lock.
        const std::string pid = std::to_string(first.pid());
        pid_t worker = -1;
        std::ifstream("/proc/" + pid + "/task/" + pid + "/children") >> worker;
        const auto serving = Pidfd::open(worker);
        ASSERT_TRUE(serving);
        first.kill();
        EXPECT_TRUE(eventually([&] { return serving->ended(); }));
      } else {
        EXPECT_EQ(first.wait(), 1) << "its caller gets the failure";
      }
    }
    DaemonProcess second({.socket = socket});
    Pair pair(second);
    pair.exchange();
  });
  std::printf("died at %u steps of the first start\n", deaths);
  EXPECT_GT(deaths, 7u);
}

// A sleeping subscription must look again: the redo log says that the publisher is gone, and no
// daemon has rung for it yet. Nobody has a connection then, and the publisher's doorbell went with
// it.
TEST(DaemonRestart, TheNextDaemonRingsForAPredecessorThatDiedBeforeItsRing) {
  const TemporaryDirectory directory;
  CrashControl control(directory.path() + "/control");
  DaemonProcess daemon({.program = AGNOCAST_TEST_CRASHING_DAEMON});
  WireClient subscriber(daemon.socket_path());
  const Incoming welcome = subscriber.hello();
  ASSERT_EQ(welcome.opcode(), wire::Opcode::welcome);
  const Incoming doorbells = subscriber.open_wait_set();
  ASSERT_EQ(doorbells.fds.size(), 2u);
  const int datagram = doorbells.fds[1].get();
  ASSERT_EQ(subscriber.create_subscription(topic_name, deep).opcode(),
            wire::Opcode::endpoint_created);
  Child publisher = publisher_child(daemon.socket_path());
  ASSERT_EQ(publisher.command('w'), '+');
  char one = 0;
  while (::recv(datagram, &one, 1, MSG_DONTWAIT) >= 0) {
  }
  pollfd rung{datagram, POLLIN, 0};
  ASSERT_EQ(::poll(&rung, 1, 0), 0) << "it sleeps";
  const pid_t former = daemon.pid();
  control.arm_at(steps::B_ring);
  publisher.end();
  ASSERT_TRUE(daemon.wait_for_next(former)) << daemon.log();
  ASSERT_TRUE(control.died_at(steps::B_ring));
  EXPECT_EQ(::poll(&rung, 1, WireClient::patience_ms), 1) << "the daemon does not ring\n"
                                                          << daemon.log();
}

}  // namespace
}  // namespace agnocast::test
