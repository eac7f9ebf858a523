// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocast-ctl journal shows the daemon's decisions and their reasons, over deaths and
// restarts. Method: as ctl_test.cpp.

#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <gmock/gmock.h>
#include <signal.h>
#include <sys/stat.h>

#include <algorithm>
#include <cstdio>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using abi::Qos;
using testing::HasSubstr;
using testing::MatchesRegex;
using wire::Opcode;
using M = SharedMemory;
using Node = CtlNode;

// Starts a publisher that dies between begin and commit; returns its pid.
pid_t die_while_publishing(const std::string& socket) {
  const pid_t pid = ::fork();
  if (pid == 0) {
    Node dying(socket);
    const auto p = dying.publisher("/points");
    const region::PublisherWords<M> words{dying.region.base(), p.extent};
    words.intent_sequence().store(p.first_sequence + 1);
    words.intent_slot().store(0);
    words.intent_op().store(abi::intent_publish);
    ::raise(SIGKILL);
  }
  ::waitpid(pid, nullptr, 0);
  return pid;
}

// Removes the times, which differ; the text after them does not.
std::string without_times(const std::string& text) {
  std::string result;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    EXPECT_THAT(line.substr(0, 12), MatchesRegex("[0-9][0-9]:[0-9][0-9]:[0-9][0-9].[0-9]+"));
    result += line.substr(std::min<std::size_t>(line.size(), 13)) + '\n';
  }
  return result;
}

TEST(CtlJournal, ShowsADeathAndItsRecovery) {
  DaemonProcess daemon;
  const std::string& socket = daemon.socket_path();
  const std::string pid = std::to_string(die_while_publishing(socket));
  ASSERT_TRUE(eventually(
      [&] { return run_ctl(socket, {"journal"}).out.find(" #10 ") != std::string::npos; }));
  const std::string process = "process 0 (wire_client, pid " + pid + "): ";
  const std::string publisher = "publisher 0 of /points (wire_client, pid " + pid + "): ";
  const CtlResult all = run_ctl(socket, {"journal"});
  EXPECT_EQ(all.status, 0) << all.err;
  EXPECT_EQ(all.err, "");
  EXPECT_EQ(
      without_times(all.out),
      "#1 " + process + "joined, uid " + std::to_string(::geteuid()) + ", domain 0\n#2 " + process +
          "publishes for one set of readers\n#3 topic /points: created\n#4 " + publisher +
          "created, 384 slots\n#5 " + process + "died\n#6 " + publisher +
          "ended with its process, last message rolled back\n#7 " + publisher +
          "removed, its entry is free\n#8 topic /points: removed: it has no endpoints left\n#9 " +
          process + "has unmapped everything of other processes\n#10 " + process +
          "removed, its entry is free\n");
  EXPECT_EQ(without_times(run_ctl(socket, {"journal", "-n", "2"}).out).substr(0, 3), "#9 ");
  const std::string of_topic = run_ctl(socket, {"journal", "--topic", "points", "-n", "1"}).out;
  EXPECT_THAT(of_topic, HasSubstr("#8 topic /points"));
  for (const char* const verb : {"journal", "monitor"}) {
    const CtlResult wrong = run_ctl(socket, {verb, "--topic", "/a b"});
    EXPECT_EQ(wrong.status, 2) << verb;
    EXPECT_THAT(wrong.err, HasSubstr("agnocast-ctl: \"/a b\": ")) << verb;
  }
  const std::string of_process = run_ctl(socket, {"journal", "--process", pid}).out;
  EXPECT_THAT(of_process, HasSubstr("died\n"));
  EXPECT_EQ(of_process.find("topic /points:"), std::string::npos);
  EXPECT_EQ(run_ctl(socket, {"journal", "--process", "nobody"}).out, "");

  const auto json = run_ctl(socket, {"journal", "-j"}).json();
  EXPECT_EQ(json["schema"], "agnocast.journal/1");
  EXPECT_EQ(json["oldest"], 1);
  EXPECT_EQ(json["newest"], 10);
  ASSERT_EQ(json["records"].size(), 10u);
  const auto& ended = json["records"][5];
  EXPECT_EQ(ended["lsn"], 6);
  EXPECT_EQ(ended["type"], "leave_publisher");
  EXPECT_EQ(ended["state"], "applied");
  EXPECT_EQ(ended["topic"], "/points");
  EXPECT_EQ(std::to_string(ended["process"]["pid"].get<int>()), pid);
  EXPECT_TRUE(ended["receiver"].is_null());
  EXPECT_EQ(ended["arguments"]["cause"], 2);
  EXPECT_EQ(ended["text"], publisher + "ended with its process, last message rolled back");
  EXPECT_THAT(ended["time"].get<std::string>(), MatchesRegex("[0-9]+-[0-9]+-[0-9]+T[0-9:.]+Z"));

  const auto counters = run_ctl(socket, {"status", "-j"}).json()["counters"];
  EXPECT_EQ(counters["processes_reaped"], 1);
  EXPECT_EQ(counters["processes_died"], 1);
  EXPECT_EQ(counters["intents_rolled_back"], 1);
  EXPECT_EQ(counters["intents_corrupt"], 0);
  EXPECT_THAT(
      run_ctl(socket, {"status"}).out,
      HasSubstr("deaths         1 process: 1 died, 0 left, 0 revoked\nintents        1 "
                "rolled back, 0 rolled forward, 0 corrupt\nrestarts       0 of the daemon"));
}

TEST(CtlJournal, SurvivesARestartAndShowsIt) {
  DaemonProcess daemon;
  const std::string& socket = daemon.socket_path();
  die_while_publishing(socket);
  const auto counters = [&] { return run_ctl(socket, {"status", "-j"}).json()["counters"]; };
  ASSERT_TRUE(eventually([&] { return counters()["processes_died"] == 1; }));
  const pid_t old = daemon.kill_worker();
  ASSERT_TRUE(daemon.wait_for_next(old)) << daemon.log();
  const auto after = counters();
  EXPECT_EQ(after["processes_died"], 1) << "counters outlive the daemon";
  EXPECT_EQ(after["intents_rolled_back"], 1);
  EXPECT_EQ(after["restarts"], 1);
  const std::string out = run_ctl(socket, {"journal"}).out;
  EXPECT_THAT(out, HasSubstr("last message rolled back\n"))
      << "the records outlive the daemon as well";
  EXPECT_THAT(out, HasSubstr("agnocastd (pid " + std::to_string(daemon.pid()) +
                             "): took over, no operation was in progress, 0 processes had died, 0 "
                             "words of the board rewritten\n"));
}

TEST(CtlJournal, SaysThatOlderOnesAreOverwritten) {
  DaemonProcess daemon;
  Node a(daemon.socket_path());
  // A topic that comes and goes makes four records.
  for (int i = 0; i < 1100; ++i) {
    const auto p = a.publisher("/points");
    a.wire.reference(Opcode::leave, wire::Kind::publisher, p.topic, p.index, p.generation);
    a.wire.reference(Opcode::drained, wire::Kind::publisher, p.topic, p.index, p.generation);
  }
  const auto lines = [&](std::vector<std::string> words) {
    words.insert(words.begin(), "journal");
    const std::string out = run_ctl(daemon.socket_path(), std::move(words)).out;
    return std::pair(out.substr(0, out.find('\n')), std::count(out.begin(), out.end(), '\n'));
  };
  const auto all = lines({"-n", "100000"});
  EXPECT_THAT(all.first, MatchesRegex("records before #[0-9]+ have been overwritten"));
  EXPECT_EQ(all.second, 4096 + 1);
  EXPECT_EQ(lines({}).second, 20) << "older records exist, but were not asked for";
  EXPECT_THAT(lines({"--process", "nobody"}).first, HasSubstr("have been overwritten"));
}

// The publisher is a client that reports a withdrawal as often as it likes.
TEST(CtlJournal, ShowsWithdrawnReadersAndIsNotFloodedByThem) {
  DaemonProcess daemon;
  const std::string& socket = daemon.socket_path();
  Node a(socket, 0, "camera"), b(socket, 0, "viewer");
  const auto p = a.publisher("/points");
  const auto s = b.subscription("/points");
  wire::Withdrawn said{};
  said.topic = p.topic;
  said.publisher = p.index;
  said.publisher_generation = p.generation;
  said.subscription = s.index;
  said.subscription_generation = s.generation;
  const auto say = [&](abi::Withdrawal why) {
    said.why = static_cast<std::uint32_t>(why);
    a.wire.send(Opcode::withdrawn, said);
  };
  const auto counters = [&] { return run_ctl(socket, {"status", "-j"}).json()["counters"]; };
  say(abi::Withdrawal::over_share);
  say(abi::Withdrawal::none);
  ASSERT_TRUE(eventually([&] { return counters()["readers_served_again"] == 1; }));
  EXPECT_EQ(counters()["readers_withdrawn"], 1);
  const std::string self = std::to_string(::getpid());
  const auto sentence = [&](const std::string& which, const std::string& end) {
    return "publisher 0 of /points (camera, pid " + self + "): reports that it " + which +
           " subscription 0 (viewer, pid " + self + ", uid " + std::to_string(::geteuid()) + ")" +
           end + '\n';
  };
  EXPECT_THAT(run_ctl(socket, {"journal", "--process", "viewer", "-n", "2"}).out,
              testing::AllOf(
                  HasSubstr(sentence("no longer serves", ": its user kept too much of the heap")),
                  HasSubstr(sentence("serves", " again"))));
  EXPECT_THAT(daemon.log(), HasSubstr("reader served again"));

  // The daemon records no reader that does not exist, and none of another client's publisher.
  said.subscription_generation = s.generation + 1;
  say(abi::Withdrawal::over_share);
  said.subscription_generation = s.generation;
  said.why = static_cast<std::uint32_t>(abi::Withdrawal::over_share);
  b.wire.send(Opcode::withdrawn, said);
  constexpr int times = 500;
  for (int i = 0; i < times; ++i) say(abi::Withdrawal::over_quota);
  ASSERT_TRUE(eventually([&] { return counters()["readers_withdrawn"] == times + 1; }))
      << "all are counted";
  const auto records = run_ctl(socket, {"journal", "-j", "-n", "4096"}).json()["records"];
  const auto withdrawn = std::count_if(records.begin(), records.end(), [](const auto& record) {
    return record["type"] == "reader_withdrawn";
  });
  EXPECT_GE(withdrawn, 10);
  EXPECT_LT(withdrawn, times / 2) << "one a minute, after some at once";
}

TEST(CtlJournal, ShowsMuteSubscriptions) {
  DaemonProcess daemon;
  const std::string& socket = daemon.socket_path();
  Node b(socket, 0, "viewer");
  b.subscription("/points");
  b.subscription("/left");
  const auto mute = [&](const std::string& topic) {
    const std::string out = run_ctl(socket, {"journal", "-n", "4096", "--topic", topic}).out;
    return out.find("(viewer, pid " + std::to_string(::getpid()) + "): has no doorbell") !=
           std::string::npos;
  };
  EXPECT_FALSE(mute("/points"));
  b.doorbells.clear();
  ASSERT_TRUE(eventually([&] { return mute("/points"); }));
  EXPECT_TRUE(mute("/left")) << "all subscriptions of the executor";
  EXPECT_FALSE(mute("/later"));
  b.subscription("/later");
  EXPECT_TRUE(eventually([&] { return mute("/later"); })) << "its executor was mute before";
  EXPECT_EQ(run_ctl(socket, {"status", "-j"}).json()["counters"]["readers_mute"], 3);
}

TEST(CtlJournal, FollowsNewRecords) {
  DaemonProcess daemon;
  Node a(daemon.socket_path());
  int ends[2];
  ASSERT_EQ(::pipe2(ends, O_CLOEXEC), 0);
  const UniqueFd reader(ends[0]);
  UniqueFd writer(ends[1]);
  const pid_t pid = ::fork();
  if (pid == 0) {
    ::dup2(writer.get(), STDOUT_FILENO);
    ::execl(AGNOCAST_TEST_CTL, AGNOCAST_TEST_CTL, "journal", "--follow", "--socket",
            daemon.socket_path().c_str(), nullptr);
    ::_exit(98);
  }
  writer.reset();
  std::string out;
  const auto read_until = [&](const std::string& wanted) {
    char buffer[4096];
    while (out.find(wanted) == std::string::npos) {
      const ssize_t count = ::read(reader.get(), buffer, sizeof buffer);
      if (count <= 0) break;
      out.append(buffer, static_cast<std::size_t>(count));
    }
  };
  read_until("joined");
  EXPECT_THAT(out, HasSubstr("joined"));
  a.publisher("/one");
  read_until("publisher 0 of /one");
  a.publisher("/two");
  read_until("publisher 0 of /two");
  ::kill(pid, SIGTERM);
  ::waitpid(pid, nullptr, 0);
  EXPECT_EQ(std::count(out.begin(), out.end(), '\n'), 6) << out;
}

}  // namespace
}  // namespace agnocast::test
