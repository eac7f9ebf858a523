// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever happens to a connection, no message is lost or arrives twice, every request is
// carried out once, and the process receives the missed events afterwards.
// Method: real daemon, real processes. The test ends connections from outside, during use by both
// sides; a stopped process (SIGSTOP) is away for as long as the test wants.

#include <agnocast/error.hpp>
#include <tests/support/crash/crash_control.hpp>
#include <tests/support/processes/client_tool.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/lowered_limit.hpp>
#include <tests/support/wire/foreign_socket.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <gtest/gtest.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace agnocast {
namespace {

using test::are_connected;
using test::ClientTool;
using test::DaemonProcess;
using test::end_connection;
using test::eventually;
using test::ForeignSocket;
using test::wire_dump;

std::string error_of(const std::string& answer) { return answer.substr(0, answer.find(' ', 6)); }
std::string error(Errc code) { return "error " + std::to_string(static_cast<int>(code)); }

/// Stops a process for a while.
class Stopped {
 public:
  explicit Stopped(pid_t pid) : pid_(pid) {
    ::kill(pid, SIGSTOP);
    int status = 0;
    ::waitpid(pid, &status, WUNTRACED);
  }
  ~Stopped() { ::kill(pid_, SIGCONT); }
  Stopped(const Stopped&) = delete;
  Stopped& operator=(const Stopped&) = delete;

 private:
  pid_t pid_;
};

TEST(Rejoin, NoMessageIsLostOrDuplicated) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  ASSERT_TRUE(meet(subscriber, "sub /t 100", publisher, "pub /t 1"));
  int ended = 0;
  for (int number = 1; number <= 1000; ++number) {
    // Also during a rejoin: the test ends whatever connection exists.
    if (number % 3 == 0) ended += end_connection(publisher.pid()) ? 1 : 0;
    if (number % 4 == 0) ended += end_connection(subscriber.pid()) ? 1 : 0;
    subscriber.tell("wait 10000");
    ASSERT_EQ(publisher.ask("publish 1 100"), "ok") << number;
    ASSERT_EQ(subscriber.answer(), "news") << number;
    ASSERT_EQ(take_all(subscriber), std::to_string(number) + " ");
  }
  EXPECT_GT(ended, 10);
  ASSERT_TRUE(are_connected({&subscriber, &publisher}));
  EXPECT_EQ(subscriber.ask("lost"), "0");
  EXPECT_EQ(subscriber.ask("links"), "1");
  EXPECT_EQ(publisher.ask("matched"), "1");
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
}

TEST(Rejoin, PublishersThatComeAndGoMeanwhileAreReadToTheLastMessage) {
  DaemonProcess daemon;
  ClientTool subscriber(daemon.socket_path());
  auto known = std::make_unique<ClientTool>(daemon.socket_path());
  ASSERT_EQ(subscriber.ask("sub /t 100"), "ok");
  ASSERT_EQ(known->ask("pub /t 10"), "ok");
  ASSERT_TRUE(known->eventually("matched", "1"));
  ASSERT_EQ(known->ask("publish 1 10"), "ok");
  ASSERT_EQ(subscriber.ask("wait 10000"), "news");
  ASSERT_EQ(take_all(subscriber), "1 ");
  ClientTool stays(daemon.socket_path());
  {
    const Stopped away(subscriber.pid());
    ASSERT_TRUE(end_connection(subscriber.pid()));
    ASSERT_EQ(known->ask("publish 2 10"), "ok");
    known.reset();  // killed
    ASSERT_TRUE(daemon.wait_for_log("client gone client=1"));
    {
      ClientTool passes_by(daemon.socket_path());
      ASSERT_EQ(passes_by.ask("pub /t 10"), "ok");
      ASSERT_EQ(passes_by.ask("publish 3 1000"), "ok");
    }
    ASSERT_TRUE(daemon.wait_for_log("client gone client=2"));
    ASSERT_EQ(stays.ask("pub /t 10"), "ok");
    ASSERT_EQ(stays.ask("publish 1 10"), "ok");
  }
  std::string heard;
  EXPECT_TRUE(eventually([&] {
    heard += take_all(subscriber);
    return heard.size() >= 12;
  }));
  EXPECT_EQ(heard.size(), 12u);
  // Every publisher's own messages in their order; the publisher that was linked first is drained
  // first.
  EXPECT_EQ(heard.substr(0, 4), "2 3 ") << heard;
  EXPECT_NE(heard.find("1 2 3 "), std::string::npos) << heard;
  EXPECT_TRUE(subscriber.eventually("links", "1")) << "the dead are unlinked";
  ASSERT_TRUE(stays.eventually("matched", "1"));
  ASSERT_EQ(stays.ask("publish 1 10"), "ok");
  ASSERT_EQ(subscriber.ask("wait 10000"), "news");
  EXPECT_EQ(take_all(subscriber), "2 ");
  EXPECT_EQ(subscriber.ask("lost"), "0");
}

TEST(Rejoin, APublisherIsNotifiedOfSubscriptionsThatCameAndWentMeanwhile) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), comes(daemon.socket_path()),
      leaves(daemon.socket_path());
  auto dies = std::make_unique<ClientTool>(daemon.socket_path());
  ASSERT_EQ(publisher.ask("pub /t 1"), "ok");
  ASSERT_EQ(leaves.ask("sub /t 5"), "ok");
  ASSERT_EQ(dies->ask("sub /t 5"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  ASSERT_EQ(dies->ask("wait 10000"), "news");
  ASSERT_EQ(dies->ask("take"), "1");
  {
    const Stopped away(publisher.pid());
    ASSERT_TRUE(end_connection(publisher.pid()));
    dies.reset();
    ASSERT_TRUE(daemon.wait_for_log("client gone"));
    ASSERT_EQ(leaves.ask("unsub"), "ok");
    ASSERT_EQ(comes.ask("sub /t 5"), "ok");
  }
  // A dead subscription may count as matched until the publisher has heard of its end, so ask the
  // new one.
  EXPECT_TRUE(comes.eventually("links", "1"));
  EXPECT_TRUE(publisher.eventually("matched", "1"));
  EXPECT_TRUE(publisher.eventually("allocated", "0")) << "messages held by the dead one are free";
  ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
  ASSERT_EQ(comes.ask("wait 10000"), "news");
  EXPECT_EQ(take_all(comes), "2 ");
}

TEST(Rejoin, ASubscriptionThatIgnoresItsProcessHearsOnlyOthersAfterwards) {
  DaemonProcess daemon;
  ClientTool both(daemon.socket_path()), other(daemon.socket_path());
  ASSERT_EQ(both.ask("pub /t 10"), "ok");
  ASSERT_TRUE(meet(both, "sub /t 100 others", other, "pub /t 10"));
  ASSERT_EQ(other.ask("sub /t 100"), "ok");
  ASSERT_TRUE(both.eventually("matched", "1"));
  // Each publishes; the number is that of the other process's message.
  const auto expect_only_others = [&](int number) {
    ASSERT_EQ(both.ask("publish 1 10"), "ok") << number;
    ASSERT_EQ(other.ask("publish 1 10"), "ok") << number;
    ASSERT_EQ(both.ask("wait 10000"), "news") << number;
    EXPECT_EQ(take_all(both), std::to_string(number) + " ");
    EXPECT_EQ(both.ask("links"), "1") << number;
  };
  expect_only_others(1);
  {
    const Stopped away(daemon.pid());
    ASSERT_TRUE(end_connection(both.pid()));
    ASSERT_TRUE(both.eventually("state", "reconnecting"));
    expect_only_others(2);
  }
  ASSERT_TRUE(are_connected({&both}));
  expect_only_others(3);
  ASSERT_TRUE(daemon.wait_for_next(daemon.kill_worker()));
  ASSERT_TRUE(are_connected({&both, &other}));
  expect_only_others(4);
  // Publishers that are created after that.
  ASSERT_EQ(both.ask("unpub"), "ok");
  ASSERT_EQ(other.ask("unpub"), "ok");
  ASSERT_TRUE(both.eventually("links", "0"));
  ASSERT_EQ(both.ask("pub /t 10"), "ok");
  ASSERT_EQ(other.ask("pub /t 10"), "ok");
  ASSERT_TRUE(both.eventually("links", "1"));
  ASSERT_TRUE(both.eventually("matched", "1"));
  ASSERT_TRUE(other.eventually("matched", "2"));
}

TEST(Rejoin, AHeapThatGrewMeanwhileIsRead) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  ASSERT_TRUE(meet(subscriber, "sub /t 100", publisher, "pub /t 1"));
  constexpr int count = 90;
  {
    const Stopped away(subscriber.pid());
    ASSERT_TRUE(end_connection(subscriber.pid()));
    // A megabyte each, all unread: more than the first window of 64 MiB.
    for (int i = 0; i < count; ++i) ASSERT_EQ(publisher.ask("publish 1 130000"), "ok") << i;
  }
  std::string heard, expected;
  for (int i = 1; i <= count; ++i) expected += std::to_string(i) + " ";
  EXPECT_TRUE(eventually([&] {
    heard += take_all(subscriber);
    return heard.size() >= expected.size();
  }));
  EXPECT_EQ(heard, expected);
}

TEST(Rejoin, AProcessThatCannotBeMappedKeepsNoPlace) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  ASSERT_EQ(subscriber.ask("sub /t 100"), "ok");
  std::uint64_t pages = 0;
  std::ifstream("/proc/" + std::to_string(subscriber.pid()) + "/statm") >> pages;
  // Enough for everything but another process's region.
  const std::uint64_t bytes = pages * static_cast<std::uint64_t>(::getpagesize()) + (64 << 20);
  const test::LoweredLimit limit(subscriber.pid(), RLIMIT_AS, bytes);
  ASSERT_EQ(publisher.ask("pub /t 1"), "ok");
  EXPECT_EQ(subscriber.ask("links"), "0");
  publisher.kill();
  EXPECT_TRUE(eventually([&] { return wire_dump(daemon.socket_path()).processes.size() == 1; }));
}

/// No descriptor is free in a process as long as the result lives.
test::LoweredLimit no_descriptor_left(pid_t pid) {
  const std::string directory = "/proc/" + std::to_string(pid) + "/fd/";
  rlim_t free = 0;
  while (::access((directory + std::to_string(free)).c_str(), F_OK) == 0 || errno != ENOENT) ++free;
  return test::LoweredLimit(pid, RLIMIT_NOFILE, free);
}

TEST(Rejoin, APacketThatAProcessHadNoDescriptorForIsRepeated) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  ASSERT_EQ(subscriber.ask("sub /t 100"), "ok");
  {
    const test::LoweredLimit full = no_descriptor_left(subscriber.pid());
    ASSERT_EQ(publisher.ask("pub /t 1"), "ok");
    ASSERT_EQ(publisher.ask("publish 1 100"), "ok");
    EXPECT_EQ(subscriber.ask("links"), "0");
  }
  EXPECT_TRUE(eventually([&] { return subscriber.ask("links") == "1"; })) << "its announcement";
  // A megabyte each, all unread: more than the first window of 64 MiB.
  constexpr int count = 90;
  {
    const test::LoweredLimit full = no_descriptor_left(subscriber.pid());
    for (int i = 1; i < count; ++i) ASSERT_EQ(publisher.ask("publish 1 130000"), "ok") << i;
  }
  std::string heard, expected;
  for (int i = 1; i <= count; ++i) expected += std::to_string(i) + " ";
  EXPECT_TRUE(eventually([&] {
    heard += take_all(subscriber);
    return heard.size() >= expected.size();
  })) << "its second window";
  EXPECT_EQ(heard, expected);
  EXPECT_EQ(subscriber.ask("lost"), "0");
}

TEST(Rejoin, AProcessWithoutADescriptorForAnAnswerGetsAnError) {
  DaemonProcess daemon;
  ClientTool process(daemon.socket_path());
  ASSERT_EQ(process.ask("sub /t 1"), "ok");
  {
    const test::LoweredLimit full = no_descriptor_left(process.pid());
    const std::string refused = process.ask("pub /t 1");
    EXPECT_TRUE(refused.starts_with("error " + std::to_string(static_cast<int>(Errc::os_failure))))
        << refused;
    EXPECT_NE(refused.find(std::strerror(EMFILE)), std::string::npos) << refused;
  }
  EXPECT_EQ(process.ask("pub /t 1"), "ok");
}

TEST(Rejoin, ARequestWhoseAnswerIsLostIsCarriedOutOnce) {
  DaemonProcess daemon({.config = "[heap]\nwindow_bytes = \"64MiB\"\n[limits]\n"
                                  "publishers_per_topic = 1\nsubscriptions_per_topic = 1\n"});
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  // Sent while the daemon is stopped; the connection ends before it can answer. The daemon carries
  // out the request, and nobody gets the answer.
  const auto ask_unanswered = [&](ClientTool& client, const std::string& line) {
    {
      const Stopped away(daemon.pid());
      ForeignSocket socket(client.pid());
      EXPECT_TRUE(socket);
      client.tell(line);
      EXPECT_TRUE(eventually([&] { return socket.has_unread(); })) << line;
      EXPECT_TRUE(socket.end_connection());
    }
    return client.answer();
  };
  // hello is sent once: the first endpoint of each process sends it here, before the test begins.
  ASSERT_EQ(publisher.ask("connect"), "ok");
  ASSERT_EQ(subscriber.ask("connect"), "ok");
  for (int round = 1; round <= 3; ++round) {
    // In the first round an executor and a window come before the endpoints.
    ASSERT_EQ(ask_unanswered(subscriber, "sub /t 5"), "ok") << round;
    ASSERT_EQ(ask_unanswered(publisher, "pub /t 1"), "ok") << round;
    ASSERT_TRUE(publisher.eventually("matched", "1")) << round;
    EXPECT_EQ(subscriber.ask("links"), "1");
    ASSERT_EQ(publisher.ask("publish 1 10"), "ok");
    ASSERT_EQ(subscriber.ask("wait 10000"), "news");
    ASSERT_EQ(take_all(subscriber), "1 ");
    ASSERT_EQ(ask_unanswered(subscriber, "unsub"), "ok") << round;
    ASSERT_EQ(ask_unanswered(publisher, "unpub"), "ok") << round;
    // There is one place for each, so the next round finds it free again or fails.
    ASSERT_TRUE(publisher.eventually("pub /t 1", "ok")) << round;
    ASSERT_EQ(publisher.ask("unpub"), "ok");
    ASSERT_TRUE(subscriber.eventually("sub /t 1", "ok")) << round;
    ASSERT_EQ(subscriber.ask("unsub"), "ok");
    ASSERT_TRUE(publisher.eventually("pub /t 1", "ok")) << round;
    ASSERT_EQ(publisher.ask("unpub"), "ok");
    ASSERT_TRUE(subscriber.eventually("sub /t 1", "ok")) << round;
    ASSERT_EQ(subscriber.ask("unsub"), "ok");
  }
}

TEST(Rejoin, AHelloWhoseWelcomeIsLostIsRepeated) {
  DaemonProcess daemon;
  ClientTool client(daemon.socket_path());
  {
    const Stopped away(daemon.pid());
    client.tell("connect");
    for (int times = 0; times < 3; ++times) {
      std::unique_ptr<ForeignSocket> socket;
      ASSERT_TRUE(eventually([&] {
        socket = std::make_unique<ForeignSocket>(client.pid());
        return *socket && socket->has_unread();
      }));
      ASSERT_TRUE(socket->end_connection());
    }
  }
  EXPECT_EQ(client.answer(), "ok");
  EXPECT_TRUE(eventually([&] { return wire_dump(daemon.socket_path()).processes.size() == 1; }));
}

TEST(Rejoin, AnAbandonedCreationLeavesNothingBehind) {
  DaemonProcess daemon({.config = "[heap]\nwindow_bytes = \"64MiB\"\n[limits]\n"
                                  "publishers_per_topic = 1\nsubscriptions_per_topic = 1\n"});
  for (const bool connection_ends : {false, true}) {
    ClientTool first(daemon.socket_path()), second(daemon.socket_path());
    // Heap and executor already exist: only the endpoint is abandoned.
    ASSERT_EQ(first.ask("pub /other 1"), "ok");
    ASSERT_EQ(first.ask("unpub"), "ok");
    ASSERT_EQ(second.ask("sub /other 1"), "ok");
    ASSERT_EQ(second.ask("unsub"), "ok");
    {
      const Stopped away(daemon.pid());
      first.tell("pub /t 1");
      second.tell("sub /t 5");
      EXPECT_EQ(error_of(first.answer()), error(Errc::daemon_not_running));
      EXPECT_EQ(error_of(second.answer()), error(Errc::daemon_not_running));
      if (connection_ends) {
        ASSERT_TRUE(end_connection(first.pid()));
        ASSERT_TRUE(end_connection(second.pid()));
      }
    }
    EXPECT_TRUE(first.eventually("pub /t 1", "ok")) << "its place is free again";
    EXPECT_TRUE(second.eventually("sub /t 5", "ok"));
    ASSERT_TRUE(first.eventually("matched", "1"));
    ASSERT_EQ(first.ask("publish 1 10"), "ok");
    ASSERT_EQ(second.ask("wait 10000"), "news");
    EXPECT_EQ(take_all(second), "1 ");
  }
}

TEST(Rejoin, EndpointsDestroyedMeanwhileHaveLeftAfterwards) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path()),
      reader(daemon.socket_path());
  ASSERT_EQ(subscriber.ask("sub /t 2 all"), "ok");
  ASSERT_EQ(publisher.ask("pub /t 100 all"), "ok");
  ASSERT_EQ(reader.ask("sub /t 1"), "ok");
  ASSERT_TRUE(publisher.eventually("matched", "2"));
  {
    const Stopped away(daemon.pid());
    ASSERT_TRUE(end_connection(subscriber.pid()));
    ASSERT_TRUE(subscriber.eventually("state", "reconnecting"));
    ASSERT_EQ(subscriber.ask("unsub"), "ok");
    EXPECT_NE(publisher.ask("publish 5 10"), "ok") << "the daemon has not heard of it";
  }
  EXPECT_TRUE(publisher.eventually("publish 5 10", "ok"));
  EXPECT_TRUE(publisher.eventually("matched", "1"));
  {
    const Stopped away(daemon.pid());
    ASSERT_TRUE(end_connection(publisher.pid()));
    ASSERT_TRUE(publisher.eventually("state", "reconnecting"));
    ASSERT_EQ(publisher.ask("unpub"), "ok");
    EXPECT_EQ(reader.ask("links"), "1");
  }
  ASSERT_EQ(reader.ask("wait 10000"), "news");
  EXPECT_NE(take_all(reader), "") << "its earlier messages are delivered";
  EXPECT_TRUE(reader.eventually("links", "0"));
}

TEST(Rejoin, ADaemonThatDiesRepeatedlyDisturbsNobody) {
  DaemonProcess daemon;
  ClientTool publisher(daemon.socket_path()), subscriber(daemon.socket_path());
  ASSERT_TRUE(meet(subscriber, "sub /t 100", publisher, "pub /t 1"));
  for (int round = 1; round <= 12; ++round) {
    const pid_t before = daemon.kill_worker();
    // All this happens before the test waits for the next daemon.
    ASSERT_EQ(publisher.ask("publish 1 100"), "ok") << round;
    auto guest = std::make_unique<ClientTool>(daemon.socket_path());
    ASSERT_EQ(guest->ask("pub /t 5"), "ok") << round;
    ASSERT_EQ(guest->ask("publish 2 100"), "ok");
    if (round % 3 == 0) daemon.kill_worker();
    if (round % 2 == 0) {
      ASSERT_EQ(guest->ask("unpub"), "ok");
    } else {
      guest->kill();
    }
    const std::string own = std::to_string(round) + " ";
    std::string heard;
    EXPECT_TRUE(eventually([&] {
      heard += take_all(subscriber);
      return heard.size() >= own.size() + 4;
    }));
    EXPECT_EQ(heard, own + "1 2 ");
    EXPECT_TRUE(subscriber.eventually("links", "1")) << "the guest is unlinked, round " << round;
    EXPECT_NE(daemon.pid(), before);
  }
  for (ClientTool* const client : {&publisher, &subscriber})
    EXPECT_TRUE(client->eventually("state", "connected"));
  EXPECT_EQ(subscriber.ask("lost"), "0");
  EXPECT_EQ(publisher.ask("matched"), "1");
  EXPECT_TRUE(publisher.eventually("allocated", "0"));
}

// The daemon dies at the n-th step of a request, for n = 1, 2, 3 … until it survives: of a process
// that joins, and of one that asks for a publisher on a topic it subscribes to.
void die_while_asked(bool comes) {
  const std::string directory = test::make_directory();
  test::CrashControl control(directory + "/control");
  DaemonProcess daemon({.program = AGNOCAST_TEST_CRASHING_DAEMON});
  unsigned deaths = 0;
  for (std::uint64_t n = 1; !testing::Test::HasFailure(); ++n, ++deaths) {
    SCOPED_TRACE("step " + std::to_string(n));
    const pid_t serves = daemon.pid();
    ClientTool client(daemon.socket_path());
    ASSERT_EQ(client.ask(comes ? "state" : "sub /t 5"), comes ? "unconnected" : "ok");
    control.arm(n);
    ASSERT_EQ(client.ask(comes ? "sub /t 5" : "pub /t 1"), "ok");
    ASSERT_TRUE(client.eventually("state", "connected"));
    control.arm(0);
    ASSERT_TRUE(comes || client.eventually("matched", "1"));
    if (daemon.pid() == serves) break;
    ASSERT_TRUE(daemon.wait_for_next(serves));
  }
  EXPECT_GT(deaths, 10u);
  test::remove_directory(directory);
}

TEST(Rejoin, AJoinWhileTheDaemonDiesIsAnsweredByTheNextDaemon) { die_while_asked(true); }

TEST(Rejoin, ARequestWhileTheDaemonDiesIsAnsweredByTheNextDaemon) { die_while_asked(false); }

}  // namespace
}  // namespace agnocast
