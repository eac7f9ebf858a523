// SPDX-License-Identifier: Apache-2.0
//
// Goal: the library's untyped core works against the real daemon between real processes, whichever
// dies. Method: agnocastd in a private directory; processes of client_tool steered line by line;
// SIGKILL for deaths. Nothing sleeps a fixed time: the test polls each asynchronous condition
// until it is true, up to a bound.

#include <tests/support/processes/client_tool.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <gtest/gtest.h>

#include <signal.h>
#include <unistd.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>

namespace agnocast {
namespace {

using test::ClientTool;
using test::DaemonProcess;

TEST(Client, AnUnsizedMessageCrossesProcesses) {
  DaemonProcess daemon;
  ClientTool subscriber(daemon.socket_path()), publisher(daemon.socket_path());
  ASSERT_EQ(subscriber.ask("sub /points 5"), "ok");
  ASSERT_EQ(publisher.ask("pub /points 1"), "ok");
  ASSERT_EQ(publisher.ask("publish 3 100000"), "ok");
  for (const char* number : {"1", "2", "3"}) {
    ASSERT_EQ(subscriber.ask("wait 10000"), "news");
    ASSERT_EQ(subscriber.ask("take"), number);
  }
  EXPECT_EQ(subscriber.ask("take"), "none");
  for (int i = 0; i < 3; ++i) EXPECT_EQ(subscriber.ask("release"), "ok");
  EXPECT_TRUE(publisher.eventually("allocated", "0"))
      << "an idle publisher's memory comes back after the last release";
}

TEST(Client, ASleepingSubscriptionIsRungAndALateJoinerGetsTheHistory) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  ASSERT_EQ(publisher.ask("pub /map 3 tl"), "ok");
  ASSERT_EQ(publisher.ask("publish 5 10"), "ok");
  ASSERT_EQ(subscriber.ask("sub /map 2 tl"), "ok");
  ASSERT_EQ(subscriber.ask("wait 10000"), "news");
  EXPECT_EQ(subscriber.ask("take"), "4");
  EXPECT_EQ(subscriber.ask("take"), "5");
  EXPECT_EQ(subscriber.ask("take"), "none");
  subscriber.tell("wait 10000");
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  EXPECT_EQ(subscriber.answer(), "news");
  EXPECT_EQ(subscriber.ask("take"), "6");
}

TEST(Client, CommittedMessagesOfADeadPublisherAreDeliveredAndStayValid) {
  DaemonProcess daemon;
  ClientTool subscriber(daemon.socket_path());
  ASSERT_EQ(subscriber.ask("sub /last 10"), "ok");
  {
    ClientTool publisher(daemon.socket_path());
    ASSERT_EQ(publisher.ask("pub /last 1"), "ok");
    ASSERT_EQ(publisher.ask("publish 4 50000"), "ok");
    publisher.kill();
  }
  for (const char* number : {"1", "2", "3", "4"}) {
    ASSERT_EQ(subscriber.ask("wait 10000"), "news");
    ASSERT_EQ(subscriber.ask("take"), number);
  }
  EXPECT_EQ(subscriber.ask("take"), "none");
  EXPECT_EQ(subscriber.ask("links"), "1") << "held messages keep the link";
  for (int i = 0; i < 4; ++i) EXPECT_EQ(subscriber.ask("release"), "ok");
  EXPECT_TRUE(subscriber.eventually("links", "0"));
  ClientTool next(daemon.socket_path());
  ASSERT_EQ(next.ask("pub /last 1"), "ok");
  ASSERT_EQ(next.ask("publish 1 10"), "ok");
  ASSERT_EQ(subscriber.ask("wait 10000"), "news");
  EXPECT_EQ(subscriber.ask("take"), "1");
}

TEST(Client, ASubscriptionCountsAndGetsTheNextMessageBeforeItsProcessCanLink) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  ASSERT_EQ(subscriber.ask("sub /counted 5"), "ok");
  ::kill(subscriber.pid(), SIGSTOP);  // its control thread cannot link
  ASSERT_EQ(publisher.ask("pub /counted 1"), "ok");
  EXPECT_EQ(publisher.ask("counted"), "1");
  EXPECT_EQ(publisher.ask("matched"), "0") << "it has not linked";
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  ::kill(subscriber.pid(), SIGCONT);
  ASSERT_EQ(subscriber.ask("wait 10000"), "news");
  EXPECT_EQ(subscriber.ask("take"), "1");
}

TEST(Client, ASubscriptionGetsWhatAnotherProcessPublishesRightAfterItsCreation) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path());
  ASSERT_EQ(publisher.ask("pub /early 1"), "ok");
  for (int number = 1; number <= 20; number += 2) {
    ASSERT_EQ(publisher.ask("publish 1 10"), "ok");  // nobody is there
    ClientTool subscriber(daemon.socket_path());
    ASSERT_EQ(subscriber.ask("sub /early 5"), "ok");
    ASSERT_EQ(publisher.ask("counted"), "1");
    ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
    ASSERT_EQ(subscriber.ask("wait 10000"), "news");
    ASSERT_EQ(subscriber.ask("take"), std::to_string(number + 1));
  }
}

TEST(Client, MessagesFlowWhileTheDaemonIsDead) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  ASSERT_EQ(subscriber.ask("sub /alone 5"), "ok");
  ASSERT_EQ(publisher.ask("pub /alone 1"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "1"));
  daemon.kill();
  // More messages than slots: the publisher must get its memory back without the daemon, too.
  for (int number = 1; number <= 1000; ++number) {
    subscriber.tell("wait 10000");
    ASSERT_EQ(publisher.ask("publish 1 1000"), "ok") << number;
    ASSERT_EQ(subscriber.answer(), "news") << number;
    ASSERT_EQ(subscriber.ask("take"), std::to_string(number));
    ASSERT_EQ(subscriber.ask("release"), "ok");
  }
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
}

TEST(Client, HoldsOfADeadSubscriberVanish) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), other(daemon.socket_path());
  ASSERT_EQ(publisher.ask("pub /held 1"), "ok");
  ASSERT_EQ(other.ask("sub /held 5"), "ok");
  {
    ClientTool subscriber(daemon.socket_path());
    ASSERT_EQ(subscriber.ask("sub /held 5"), "ok");
    ASSERT_TRUE(publisher.eventually("matched", "2"));
    ASSERT_EQ(publisher.ask("publish 3 1000"), "ok");
    ASSERT_EQ(subscriber.ask("wait 10000"), "news");
    ASSERT_EQ(subscriber.ask("take"), "1");
    ASSERT_EQ(subscriber.ask("take"), "2");
    subscriber.kill();
  }
  for (const char* number : {"1", "2", "3"}) {
    ASSERT_EQ(other.ask("wait 10000"), "news");
    ASSERT_EQ(other.ask("take"), number);
    ASSERT_EQ(other.ask("release"), "ok");
  }
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
  EXPECT_TRUE(publisher.eventually("matched", "1"));
}

TEST(Client, EndpointsComeAndGoAndLeaveNothingBehind) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  for (int round = 0; round < 30; ++round) {
    ASSERT_EQ(subscriber.ask("sub /again 5"), "ok") << "round " << round;
    ASSERT_EQ(publisher.ask("pub /again 1"), "ok") << "round " << round;
    ASSERT_EQ(publisher.ask("publish 2 100"), "ok");
    ASSERT_EQ(subscriber.ask("wait 10000"), "news");
    ASSERT_EQ(subscriber.ask("take"), "1");
    ASSERT_EQ(subscriber.ask("take"), "2");
    ASSERT_EQ(subscriber.ask("release"), "ok");
    ASSERT_EQ(subscriber.ask("release"), "ok");
    if (round % 2 == 0) {
      ASSERT_EQ(subscriber.ask("unsub"), "ok");
      ASSERT_EQ(publisher.ask("unpub"), "ok");
    } else {
      ASSERT_EQ(publisher.ask("unpub"), "ok");
      ASSERT_EQ(subscriber.ask("unsub"), "ok");
    }
  }
}

TEST(Client, TheHeapGrowsUnderAReader) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  ASSERT_EQ(subscriber.ask("sub /grow 3"), "ok");
  ASSERT_EQ(publisher.ask("pub /grow 1"), "ok");
  for (int round = 1; round <= 12; ++round) {
    ASSERT_EQ(publisher.ask("publish 1 " + std::to_string(100000 * round)), "ok");
    // A take finds nothing while its process does not know the window yet; then it is woken again.
    std::string taken = "none";
    for (int i = 0; i < 3 && taken == "none"; ++i) {
      ASSERT_EQ(subscriber.ask("wait 10000"), "news");
      taken = subscriber.ask("take");
    }
    ASSERT_EQ(taken, std::to_string(round));
    if (round % 3 == 0) {
      for (int i = 0; i < 3; ++i) ASSERT_EQ(subscriber.ask("release"), "ok");
    }
  }
}

// Destructors of messages run there: a fault has to reach the application's handler.
TEST(Client, ItsThreadTakesOnlyTheSignalsThatItCauses) {
  DaemonProcess daemon;
  ClientTool tool(daemon.socket_path());
  ASSERT_EQ(tool.ask("sub /t 1"), "ok");
  std::uint64_t blocked = 0;
  for (const auto& task :
       std::filesystem::directory_iterator("/proc/" + std::to_string(tool.pid()) + "/task")) {
    std::string name, line;
    std::ifstream(task.path() / "comm") >> name;
    if (name != "agnocast-ctl") continue;
    std::ifstream status(task.path() / "status");
    while (std::getline(status, line)) {
      if (line.rfind("SigBlk:", 0) == 0) blocked = std::stoull(line.substr(7), nullptr, 16);
    }
  }
  const auto blocks = [&](int signal) { return (blocked >> (signal - 1) & 1) != 0; };
  EXPECT_TRUE(blocks(SIGTERM) && blocks(SIGUSR1) && blocks(SIGPROF));
  EXPECT_FALSE(blocks(SIGSEGV) || blocks(SIGBUS) || blocks(SIGFPE) || blocks(SIGILL));
}

TEST(Client, WithoutADaemonCreationFailsAndNothingElseHappens) {
  ClientTool tool("/nonexistent/agnocastd.sock");
  const std::string answer = tool.ask("sub /points 5");
  EXPECT_NE(answer.find("agnocastd does not answer"), std::string::npos) << answer;
  EXPECT_NE(answer.find("/nonexistent/agnocastd.sock"), std::string::npos) << answer;
}

}  // namespace
}  // namespace agnocast
