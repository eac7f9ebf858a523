// SPDX-License-Identifier: Apache-2.0
//
// Goal: services between processes, when one of them, or the daemon, is killed or stopped.
// Method: service_tool as servers and clients, real signals, the real daemon.

#ifdef AGNOCAST_TEST_CTL
#include <tests/support/processes/ctl.hpp>
#endif
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/steered_process.hpp>

#include <gmock/gmock.h>

#include <signal.h>
#include <sys/wait.h>

#include <chrono>
#include <memory>
#include <string>
#include <vector>

namespace agnocast {
namespace {

using test::eventually;

class ServiceProcesses : public testing::Test {
 protected:
  struct Tool : test::SteeredProcess {
    explicit Tool(const test::DaemonProcess& daemon)
        : SteeredProcess({AGNOCAST_SERVICE_TOOL}, {"AGNOCAST_SOCKET=" + daemon.socket_path()}) {}
    /// Stops it until go_on().
    void stop() {
      ::kill(pid(), SIGSTOP);
      ::waitpid(pid(), nullptr, WUNTRACED);
    }
    void go_on() { ::kill(pid(), SIGCONT); }
  };
  test::DaemonProcess daemon_{
      {.config = "[heap]\nwindow_bytes = \"64MiB\"\n" AGNOCAST_TEST_ARENA_BASE}};
};

TEST_F(ServiceProcesses, AskAndAnswer) {
  Tool server(daemon_), client(daemon_);
  ASSERT_EQ(client.ask("client repeat"), "ok");
  EXPECT_EQ(client.ask("ready"), "no");
  ASSERT_EQ(server.ask("serve repeat"), "ok");
  ASSERT_EQ(client.ask("wait 20000", 30), "yes");
  for (int i = 1; i <= 50; ++i) {
    ASSERT_EQ(client.ask("ask " + std::to_string(1000 + i)), std::to_string(i));
    ASSERT_EQ(client.ask("result " + std::to_string(i)), std::to_string(1000 + i));
  }
}

TEST_F(ServiceProcesses, AKilledServerLeavesAnErrorAndItsEarlierResponses) {
  Tool server(daemon_), client(daemon_);
  ASSERT_EQ(server.ask("defer repeat"), "ok");
  ASSERT_EQ(client.ask("client repeat"), "ok");
  ASSERT_EQ(client.ask("wait 20000", 30), "yes");
  ASSERT_EQ(client.ask("ask 71"), "1");
  ASSERT_EQ(client.ask("ask 72"), "2");
  ASSERT_TRUE(server.eventually("held", "2"));
  // The client cannot take the response before the server is dead.
  client.stop();
  ASSERT_EQ(server.ask("answer 0"), "ok");
  server.kill();
  client.go_on();
  EXPECT_EQ(client.ask("result 2"), "no_server");
  EXPECT_EQ(client.ask("result 1"), "71");
  EXPECT_TRUE(client.eventually("ready", "no"));
  EXPECT_EQ(client.ask("ask 73"), "no_server");
  Tool next(daemon_);
  ASSERT_EQ(next.ask("serve repeat"), "ok");
  ASSERT_EQ(client.ask("wait 20000", 30), "yes");
  const std::string again = client.ask("ask 74");
  EXPECT_EQ(client.ask("result " + again), "74");
}

#ifdef AGNOCAST_TEST_CTL
TEST_F(ServiceProcesses, ARevokedClientWaitsForNoUnreadResponse) {
  Tool server(daemon_), client(daemon_);
  ASSERT_EQ(server.ask("defer repeat"), "ok");
  ASSERT_EQ(client.ask("client repeat"), "ok");
  ASSERT_EQ(client.ask("wait 20000", 30), "yes");
  ASSERT_EQ(client.ask("ask 71"), "1");
  ASSERT_TRUE(server.eventually("held", "1"));
  client.stop();
  ASSERT_EQ(server.ask("answer 0"), "ok");
  server.stop();  // so its sent response stays
  const auto revoked =
      test::run_ctl(daemon_.socket_path(), {"process", "revoke", std::to_string(client.pid())});
  EXPECT_EQ(revoked.status, 0) << revoked.err;
  client.go_on();
  EXPECT_EQ(client.ask("result 1"), "no_server");
}
#endif

TEST_F(ServiceProcesses, AKilledServerIsReplacedByTheOtherOne) {
  Tool first(daemon_), second(daemon_), client(daemon_);
  ASSERT_EQ(first.ask("defer repeat"), "ok");
  ASSERT_EQ(client.ask("client repeat"), "ok");
  ASSERT_EQ(client.ask("wait 20000", 30), "yes");
  ASSERT_EQ(second.ask("defer repeat"), "ok");
  ASSERT_TRUE(client.eventually("servers", "2"));
  ASSERT_EQ(client.ask("ask 5"), "1");
  ASSERT_TRUE(second.eventually("held", "1"));
  first.kill();
  ASSERT_EQ(second.ask("answer 0"), "ok");
  EXPECT_EQ(client.ask("result 1"), "5");
}

TEST_F(ServiceProcesses, AKilledClientIsForgotten) {
  Tool server(daemon_), stays(daemon_);
  ASSERT_EQ(server.ask("defer repeat"), "ok");
  ASSERT_EQ(stays.ask("client repeat"), "ok");
  ASSERT_EQ(stays.ask("wait 20000", 30), "yes");
  for (int round = 0; round < 5; ++round) {
    Tool client(daemon_);
    ASSERT_EQ(client.ask("client repeat"), "ok");
    ASSERT_EQ(client.ask("wait 20000", 30), "yes");
    ASSERT_EQ(client.ask("ask 1"), "1");
    ASSERT_TRUE(server.eventually("held", std::to_string(round + 1)));
    client.kill();
    ASSERT_TRUE(server.eventually("clients", "1"));
    EXPECT_EQ(server.ask("answer " + std::to_string(round)), "endpoint_gone");
  }
  ASSERT_EQ(stays.ask("ask 9"), "1");
  ASSERT_TRUE(server.eventually("held", "6"));
  EXPECT_EQ(server.ask("answer 5"), "ok");
  EXPECT_EQ(stays.ask("result 1"), "9");
}

TEST_F(ServiceProcesses, AStoppedClientDelaysNoOther) {
  Tool server(daemon_), stopped(daemon_), client(daemon_);
  ASSERT_EQ(server.ask("defer repeat 2"), "ok");
  ASSERT_EQ(stopped.ask("client repeat 2"), "ok");
  ASSERT_EQ(client.ask("client repeat 2"), "ok");
  ASSERT_EQ(stopped.ask("wait 20000", 30), "yes");
  ASSERT_EQ(client.ask("wait 20000", 30), "yes");
  for (int i = 1; i <= 3; ++i) {
    ASSERT_EQ(stopped.ask("ask 4"), std::to_string(i));
    ASSERT_TRUE(server.eventually("held", std::to_string(i)));
  }
  stopped.stop();
  EXPECT_EQ(server.ask("answer 0"), "ok");
  EXPECT_EQ(server.ask("answer 1"), "ok");
  EXPECT_EQ(server.ask("answer 2"), "would_block");
  ASSERT_EQ(client.ask("ask 6"), "1");
  ASSERT_TRUE(server.eventually("held", "4"));
  EXPECT_EQ(server.ask("answer 3"), "ok");
  EXPECT_EQ(client.ask("result 1"), "6");
  stopped.go_on();
  EXPECT_EQ(stopped.ask("result 1"), "4");
  EXPECT_EQ(stopped.ask("result 2"), "4");
  EXPECT_TRUE(server.eventually("answer 2", "ok"));
  EXPECT_EQ(stopped.ask("result 3"), "4");
}

TEST_F(ServiceProcesses, GoOnWhileTheDaemonIsDeadAndAfterwards) {
  Tool server(daemon_), client(daemon_);
  ASSERT_EQ(server.ask("serve repeat"), "ok");
  ASSERT_EQ(client.ask("client repeat"), "ok");
  ASSERT_EQ(client.ask("wait 20000", 30), "yes");
  const pid_t old = daemon_.kill_worker();
  for (int i = 1; i <= 20; ++i) {
    ASSERT_EQ(client.ask("ask 3"), std::to_string(i));
    ASSERT_EQ(client.ask("result " + std::to_string(i)), "3");
  }
  ASSERT_TRUE(daemon_.wait_for_next(old));
  ASSERT_EQ(client.ask("ask 3"), "21");
  EXPECT_EQ(client.ask("result 21"), "3");
  Tool late(daemon_);
  ASSERT_EQ(late.ask("client repeat"), "ok");
  ASSERT_EQ(late.ask("wait 20000", 30), "yes");
  ASSERT_EQ(late.ask("ask 8"), "1");
  EXPECT_EQ(late.ask("result 1"), "8");
  EXPECT_TRUE(server.eventually("clients", "2"));
}

TEST_F(ServiceProcesses, AServerThatDiesWithTheDaemonIsReportedAfterwards) {
  Tool server(daemon_), client(daemon_);
  ASSERT_EQ(server.ask("defer repeat"), "ok");
  ASSERT_EQ(client.ask("client repeat"), "ok");
  ASSERT_EQ(client.ask("wait 20000", 30), "yes");
  ASSERT_EQ(client.ask("ask 3"), "1");
  ASSERT_TRUE(server.eventually("held", "1"));
  const pid_t old = daemon_.kill_worker();
  server.kill();
  ASSERT_TRUE(daemon_.wait_for_next(old));
  EXPECT_EQ(client.ask("result 1"), "no_server");
}

TEST_F(ServiceProcesses, GoOnWithADaemonWithoutAStore) {
  auto daemon = std::make_unique<test::DaemonProcess>(
      test::DaemonOptions{.config = "[heap]\nwindow_bytes = \"64MiB\"\n" AGNOCAST_TEST_ARENA_BASE});
  const std::string socket = daemon->socket_path();
  Tool server(*daemon), client(*daemon);
  ASSERT_EQ(server.ask("serve repeat"), "ok");
  ASSERT_EQ(client.ask("client repeat"), "ok");
  ASSERT_EQ(client.ask("wait 20000", 30), "yes");
  ASSERT_EQ(client.ask("ask 3"), "1");
  ASSERT_EQ(client.ask("result 1"), "3");
  daemon->kill();
  for (Tool* const tool : {&server, &client}) ASSERT_TRUE(tool->eventually("connected", "no"));
  test::DaemonProcess next(
      {.config = "[heap]\nwindow_bytes = \"64MiB\"\n" AGNOCAST_TEST_ARENA_BASE, .socket = socket});
  // Before any other process, which could get their addresses.
  for (Tool* const tool : {&server, &client}) ASSERT_TRUE(tool->eventually("connected", "yes"));
  Tool late(next);
  ASSERT_EQ(late.ask("client repeat"), "ok");
  ASSERT_EQ(late.ask("wait 20000", 30), "yes");
  ASSERT_EQ(late.ask("ask 8"), "1");
  EXPECT_EQ(late.ask("result 1"), "8");
  EXPECT_TRUE(server.eventually("clients", "2"));
  ASSERT_EQ(client.ask("wait 20000", 30), "yes");
  ASSERT_EQ(client.ask("ask 4"), "2");
  EXPECT_EQ(client.ask("result 2"), "4");
}

class RefusedServiceProcesses : public ServiceProcesses {
 protected:
  // So the second server of a service gets no publisher to a client of the first one.
  test::DaemonProcess strict_{{.config =
                                   "[heap]\nwindow_bytes = \"64MiB\"\n" AGNOCAST_TEST_ARENA_BASE
                                   "[limits]\npublishers_per_topic = 1\n"}};
  Tool first_{strict_}, second_{strict_}, client_{strict_};
  void SetUp() override {
    ASSERT_EQ(first_.ask("defer repeat"), "ok");
    ASSERT_EQ(client_.ask("client repeat"), "ok");
    ASSERT_EQ(client_.ask("wait 20000", 30), "yes");
    ASSERT_EQ(second_.ask("defer repeat"), "ok");
    ASSERT_TRUE(second_.eventually("refused", "1 limit_reached"));
    ASSERT_EQ(client_.ask("ask 5"), "1");
    ASSERT_TRUE(second_.eventually("held", "1"));
  }
};

TEST_F(RefusedServiceProcesses, AServerReportsWhyItCannotAnswerAndCanWhenTheReasonIsGone) {
  EXPECT_EQ(client_.ask("servers"), "1");
  EXPECT_EQ(second_.ask("answer 0"), "limit_reached");
  first_.kill();
  EXPECT_EQ(client_.ask("result 1"), "no_server")
      << "the server that could have answered it is gone";
  ASSERT_TRUE(second_.eventually("clients", "1"));
  EXPECT_EQ(second_.ask("refused"), "0 limit_reached");
  ASSERT_EQ(client_.ask("wait 20000", 30), "yes");
  ASSERT_EQ(client_.ask("ask 6"), "2");
  ASSERT_TRUE(second_.eventually("held", "2"));
  ASSERT_EQ(second_.ask("answer 1"), "ok");
  EXPECT_EQ(client_.ask("result 2"), "6");
}

TEST_F(RefusedServiceProcesses, AServerThatAnswersWaitsForNoDaemon) {
  // The library retries every second, and then waits for this daemon, up to five seconds.
  strict_.kill_worker(SIGSTOP);
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(2);
  while (std::chrono::steady_clock::now() < end)
    ASSERT_EQ(second_.ask("answer 0", 3), "limit_reached");
  strict_.kill_worker(SIGCONT);
}

TEST_F(ServiceProcesses, AnEndingServiceWaitsOnceForAStoppedDaemon) {
  Tool server(daemon_);
  ASSERT_EQ(server.ask("serve repeat"), "ok");
  std::vector<std::unique_ptr<Tool>> clients;
  for (int i = 0; i < 4; ++i) {
    clients.push_back(std::make_unique<Tool>(daemon_));
    ASSERT_EQ(clients.back()->ask("client repeat"), "ok");
    ASSERT_EQ(clients.back()->ask("wait 20000", 30), "yes");
  }
  daemon_.kill_worker(SIGSTOP);
  EXPECT_EQ(server.ask("unserve", 12), "ok") << "five seconds, and not for each client";
  daemon_.kill_worker(SIGCONT);
  for (auto& client : clients) EXPECT_TRUE(client->eventually("ready", "no"));
}

}  // namespace
}  // namespace agnocast
