// SPDX-License-Identifier: Apache-2.0
//
// Goal: the effects of a death, a stop and a revocation on the remaining peers. Committed messages
// are delivered, also to a subscription that was still linking; held messages stay whole as long
// as they are held, and memory and addresses come back with the last release; a process that does
// not read blocks nobody, is bounded, appears in agnocast-ctl, can be revoked, and learns of it.
// Method: nodes of the public interface in their own processes, ended at once after a publish,
// killed, or stopped by SIGSTOP meanwhile.

#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/steered_process.hpp>
#include <tests/system/random.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <memory>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

class Death : public testing::Test {
 protected:
  std::unique_ptr<SteeredProcess> node(bool publishes = false) {
    return std::make_unique<SteeredProcess>(std::vector<std::string>{AGNOCAST_MORTAL},
                                            variables(publishes));
  }
  std::vector<std::string> variables(bool publishes) const {
    std::vector<std::string> all{"AGNOCAST_SOCKET=" + daemon_.socket_path()};
    if (publishes) all.push_back("LD_PRELOAD=" AGNOCAST_HOOK);
    return all;
  }
  /// Starts a publisher that publishes 1 … count and ends at once.
  pid_t begin_once(const std::string& topic, const std::string& qos, int count) {
    std::vector<std::string> words{AGNOCAST_MORTAL, "once", topic, qos, std::to_string(count)};
    std::vector<std::string> added = variables(true);
    std::vector<char*> argv, environment;
    for (std::string& word : words) argv.push_back(word.data());
    for (std::string& variable : added) environment.push_back(variable.data());
    argv.push_back(nullptr);
    environment.push_back(nullptr);
    pid_t pid = -1;
    EXPECT_EQ(::posix_spawn(&pid, argv[0], nullptr, nullptr, argv.data(), environment.data()), 0);
    return pid;
  }
  static int end_of(pid_t pid) {
    int status = 0;
    ::waitpid(pid, &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }
  void once(const std::string& topic, const std::string& qos, int count) {
    const pid_t pid = begin_once(topic, qos, count);
    EXPECT_EQ(end_of(pid), 0);
    EXPECT_TRUE(is_reaped(pid));
  }
  static bool is_reaped(pid_t pid, const DaemonProcess& daemon) {
    const std::string name = " pid=" + std::to_string(pid) + " ";
    return eventually([&] {
      std::istringstream log(daemon.log());
      for (std::string line; std::getline(log, line);) {
        if (line.find("client gone") != std::string::npos && line.find(name) != std::string::npos)
          return true;
      }
      return false;
    });
  }
  bool is_reaped(pid_t pid) const { return is_reaped(pid, daemon_); }
  nlohmann::json ctl(std::vector<std::string> words) {
    words.push_back("--json");
    const CtlResult result = run_ctl(daemon_.socket_path(), std::move(words));
    EXPECT_EQ(result.status, 0) << result.err;
    return result.json();
  }
  nlohmann::json process(pid_t pid) {
    const nlohmann::json all = ctl({"process", "list"});
    for (const auto& one : all["processes"]) {
      if (one["pid"] == pid) return one;
    }
    return {};
  }
  static void stop(const SteeredProcess& process) {
    ::kill(process.pid(), SIGSTOP);
    siginfo_t info{};
    ASSERT_EQ(::waitid(P_PID, static_cast<id_t>(process.pid()), &info, WSTOPPED), 0);
  }
  static void go_on(const SteeredProcess& process) { ::kill(process.pid(), SIGCONT); }

  DaemonProcess daemon_{{.arguments = {"--log-level", "debug"}}};
};

TEST_F(Death, RightAfterAPublishLosesNothingForAnEarlierSubscription) {
  const auto subscriber = node();
  ASSERT_EQ(subscriber->ask("sub /once 10 16"), "ok");
  Random random(11);
  for (int round = 0; round < 60 && !HasFailure(); ++round) {
    SCOPED_TRACE(round);
    // Running; stopped before it can link, until the publisher is gone; or somewhere in between.
    const int how = round % 3;
    if (how != 0) stop(*subscriber);
    const pid_t publisher = begin_once("/once", "1", 5);
    if (how == 2) {
      ::usleep(static_cast<useconds_t>(random.below(30'000)));
      go_on(*subscriber);
    }
    EXPECT_EQ(end_of(publisher), 0);
    if (how == 1) {
      EXPECT_TRUE(is_reaped(publisher));
      go_on(*subscriber);
    }
    EXPECT_EQ(subscriber->ask("expect 1 5"), "ok");
  }
  EXPECT_EQ(subscriber->ask("take"), "none");
  EXPECT_EQ(subscriber->ask("lost"), "0");
}

TEST_F(Death, RightAfterAPublishIsAllOrNothingForASubscriptionThatIsJoining) {
  const auto subscriber = node();
  ASSERT_EQ(subscriber->ask("barrier"), "ok");
  Random random(12);
  int all = 0, nothing = 0;
  for (int round = 0; round < 60 && !HasFailure(); ++round) {
    SCOPED_TRACE(round);
    const auto publisher = node(true);
    ASSERT_EQ(publisher->ask("pub /elsewhere 1"), "ok");
    const std::string topic = " /moment" + std::to_string(round);
    publisher->tell("once" + topic + " 5t 5");
    ::usleep(static_cast<useconds_t>(random.below(1'500)));
    subscriber->tell("sub" + topic + " 5t 16");
    if (round % 2 == 0) {
      ::usleep(static_cast<useconds_t>(random.below(500)));
      stop(*subscriber);
    }
    const pid_t pid = publisher->pid();
    EXPECT_EQ(publisher->answer(), "(it has ended)");
    EXPECT_TRUE(is_reaped(pid));
    go_on(*subscriber);
    ASSERT_EQ(subscriber->answer(), "ok");
    ASSERT_EQ(subscriber->ask("barrier"), "ok");
    const std::string got = subscriber->ask("rest");
    // It was on the topic together with the publisher, or came when the publisher was gone.
    EXPECT_TRUE(got == "1 5" || got == "none") << got;
    ++(got == "none" ? nothing : all);
    EXPECT_EQ(subscriber->ask("lost"), "0");
  }
  std::printf("  all in %d rounds, nothing in %d\n", all, nothing);
}

TEST_F(Death, OfAPublisherKeepsHeldMessagesAndFreesAddressesWithTheLastRelease) {
  const auto subscriber = node();
  ASSERT_EQ(subscriber->ask("sub /held 10 16"), "ok");
  ASSERT_EQ(subscriber->ask("maps"), "0");
  std::string first_window;
  for (int life = 0; life < 5 && !HasFailure(); ++life) {
    auto publisher = node(true);
    ASSERT_EQ(publisher->ask("pub /held 1"), "ok");
    ASSERT_EQ(publisher->ask("publish 6"), "ok");
    const std::string window = publisher->ask("window");
    if (life == 0) first_window = window;
    EXPECT_EQ(window, first_window) << "the addresses of the previous process are used again";
    ASSERT_TRUE(subscriber->eventually("matched", "1"));
    for (const char* number : {"1", "2", "3"}) ASSERT_EQ(subscriber->ask("take"), number);
    const pid_t pid = publisher->pid();
    publisher->kill();
    ASSERT_TRUE(is_reaped(pid));
    for (const char* number : {"4", "5", "6"}) ASSERT_EQ(subscriber->ask("take"), number);
    EXPECT_EQ(subscriber->ask("take"), "none");
    {
      // Other processes come and go, and write into their own memory.
      auto other = node(true);
      ASSERT_EQ(other->ask("pub /other 1"), "ok");
      ASSERT_EQ(other->ask("publish 100"), "ok");
      EXPECT_NE(other->ask("window"), first_window) << "a subscription still reads there";
    }
    EXPECT_EQ(subscriber->ask("check"), "ok");
    EXPECT_NE(subscriber->ask("maps"), "0");
    EXPECT_EQ(subscriber->ask("drop"), "ok");
    EXPECT_TRUE(subscriber->eventually("maps", "0"));
    EXPECT_TRUE(eventually([&] { return ctl({"process", "list"})["process_count"] == 1; }));
  }
}

TEST_F(Death, OfASubscriberFreesItsHeldMessagesWithNoFurtherPublish) {
  const auto publisher = node(true);
  auto subscriber = node();
  ASSERT_EQ(publisher->ask("pub /vanish 1"), "ok");
  ASSERT_EQ(subscriber->ask("sub /vanish 10 16"), "ok");
  ASSERT_TRUE(publisher->eventually("matched", "1"));
  ASSERT_EQ(publisher->ask("publish 8"), "ok");
  for (const char* number : {"1", "2", "3"}) ASSERT_EQ(subscriber->ask("take"), number);
  const auto allocated = [&] {
    return ctl({"topic", "info", "/vanish"})["publishers"][0]["allocated_messages"].get<int>();
  };
  EXPECT_EQ(allocated(), 8);
  subscriber->kill();
  EXPECT_TRUE(eventually([&] { return allocated() == 0; }));
}

TEST_F(Death, AStoppedSubscriberBlocksNobodyIsReportedAndCanBeRevoked) {
  const auto publisher = node(true), idle = node(), busy = node();
  ASSERT_EQ(publisher->ask("pub /stop 1"), "ok");
  ASSERT_EQ(idle->ask("sub /stop 20 4"), "ok");
  ASSERT_EQ(busy->ask("sub /stop 1000 16"), "ok");
  ASSERT_TRUE(publisher->eventually("matched", "2"));
  ASSERT_TRUE(idle->eventually("events", "1 1"));
  ASSERT_EQ(publisher->ask("publish 4"), "ok");
  for (const char* number : {"1", "2", "3"}) ASSERT_EQ(idle->ask("take"), number);
  stop(*idle);
  const auto allocated = [&] {
    return ctl({"topic", "info", "/stop"})["publishers"][0]["allocated_messages"].get<int>();
  };
  ASSERT_EQ(busy->ask("expect 1 4"), "ok");
  for (int round = 0; round < 20; ++round) {
    ASSERT_EQ(publisher->ask("publish 100"), "ok");
    ASSERT_EQ(busy->ask("expect " + std::to_string(5 + round * 100) + " " +
                        std::to_string(104 + round * 100)),
              "ok");
  }
  EXPECT_EQ(busy->ask("lost"), "0");
  EXPECT_TRUE(eventually([&] { return allocated() == 23; })) << "its depth, and the held messages";
  const auto seen = process(idle->pid());
  EXPECT_EQ(seen["state"], "stopped");
  EXPECT_EQ(seen["unread_messages"], 20);
  EXPECT_EQ(seen["held_messages"], 3);
  EXPECT_EQ(seen["kept_slots"], 23);
  EXPECT_EQ(process(busy->pid())["state"], "alive");
  EXPECT_EQ(process(busy->pid())["kept_slots"], 0);

  const std::string pid = std::to_string(idle->pid());
  const CtlResult revoked = run_ctl(daemon_.socket_path(), {"process", "revoke", pid});
  EXPECT_EQ(revoked.status, 0) << revoked.err;
  EXPECT_THAT(revoked.out, HasSubstr("(pid " + pid + ", uid "));
  EXPECT_THAT(revoked.out, HasSubstr("0 publishers, 1 subscription; it is stopped"));
  EXPECT_TRUE(eventually([&] { return allocated() == 0; })) << "with no further publish";
  EXPECT_EQ(process(idle->pid())["state"], "revoked");
  EXPECT_EQ(run_ctl(daemon_.socket_path(), {"process", "revoke", pid}).status, 4);

  go_on(*idle);
  EXPECT_EQ(idle->ask("take"), "none");
  EXPECT_TRUE(idle->eventually("active", "0 0"));
  EXPECT_EQ(idle->ask("matched"), "0");
  EXPECT_TRUE(idle->eventually("events", "2 0")) << "the application is notified";
  EXPECT_THAT(idle->ask("sub /another 1 1"), StartsWith("refused the session of this process"));
  EXPECT_THAT(idle->ask("sub /another 1 1"), HasSubstr("revoked by user "));
  EXPECT_NE(idle->ask("drop"), "(it has ended)") << "the held messages are still mapped";
  EXPECT_EQ(publisher->ask("publish 1"), "ok");
  EXPECT_EQ(busy->ask("expect 2005 2005"), "ok");

  const auto counted_once = [&] {
    const auto counters = ctl({"status"})["counters"];
    EXPECT_EQ(counters["processes_revoked"], 1);
    EXPECT_EQ(counters["processes_died"], 0);
    EXPECT_EQ(counters["processes_unmapped"], 0);
    EXPECT_EQ(counters["processes_reaped"], 1);
  };
  counted_once();
  const pid_t gone = idle->pid();
  idle->kill();
  EXPECT_TRUE(is_reaped(gone));
  EXPECT_TRUE(eventually([&] { return process(gone).is_null(); }));
  counted_once();
  const CtlResult status = run_ctl(daemon_.socket_path(), {"status"});
  EXPECT_THAT(status.out, HasSubstr("1 process: 0 died, 0 left, 1 revoked"));
}

TEST_F(Death, OfTheDaemonKeepsARevocationAndAStoppedProcessLearnsOfItWhenItGoesOn) {
  const auto publisher = node(true), first = node(), second = node(), busy = node();
  ASSERT_EQ(publisher->ask("pub /away 1"), "ok");
  ASSERT_EQ(first->ask("sub /away 20 4"), "ok");
  ASSERT_EQ(second->ask("sub /away 20 4"), "ok");
  ASSERT_EQ(busy->ask("sub /away 1000 16"), "ok");
  ASSERT_TRUE(publisher->eventually("matched", "3"));
  ASSERT_EQ(publisher->ask("publish 4"), "ok");
  ASSERT_EQ(busy->ask("expect 1 4"), "ok");
  ASSERT_EQ(second->ask("take"), "1");
  const auto revoke = [&](const SteeredProcess& one) {
    return run_ctl(daemon_.socket_path(), {"process", "revoke", std::to_string(one.pid())}).status;
  };
  const auto restart = [&] {
    const pid_t old = daemon_.kill_worker();
    ASSERT_TRUE(daemon_.wait_for_next(old));
    // Running processes have rejoined.
    ASSERT_TRUE(eventually([&] {
      return process(busy->pid())["state"] == "alive" &&
             process(publisher->pid())["state"] == "alive";
    }));
  };
  EXPECT_EQ(revoke(*first), 0);
  ASSERT_TRUE(first->eventually("active", "0 0"));
  stop(*second);
  restart();
  EXPECT_EQ(process(first->pid())["state"], "revoked");
  EXPECT_THAT(first->ask("sub /another 1 1"), StartsWith("refused the session of this process"));
  EXPECT_EQ(revoke(*second), 0) << "the process has no connection";
  restart();
  EXPECT_EQ(process(first->pid())["state"], "revoked");
  EXPECT_EQ(process(second->pid())["state"], "revoked");
  go_on(*second);
  EXPECT_EQ(second->ask("take"), "none");
  EXPECT_TRUE(second->eventually("active", "0 0"));
  EXPECT_EQ(second->ask("matched"), "0");
  EXPECT_THAT(second->ask("sub /another 1 1"), StartsWith("refused the session of this process"));
  EXPECT_EQ(publisher->ask("publish 1"), "ok");
  EXPECT_EQ(busy->ask("expect 5 5"), "ok");
  EXPECT_EQ(busy->ask("lost"), "0");
  EXPECT_EQ(ctl({"status"})["counters"]["processes_revoked"], 2);
}

TEST_F(Death, ARevokedPublisherReportsItAndItsCommittedMessagesAreDelivered) {
  const auto publisher = node(true), subscriber = node();
  ASSERT_EQ(publisher->ask("pub /over 1"), "ok");
  ASSERT_EQ(subscriber->ask("sub /over 10 16"), "ok");
  ASSERT_TRUE(publisher->eventually("matched", "1"));
  ASSERT_EQ(publisher->ask("publish 5"), "ok");
  ASSERT_EQ(subscriber->ask("take"), "1");
  const std::string client = [&] {
    const auto one = process(publisher->pid());
    return std::to_string(one["client_index"].get<int>()) + "." +
           std::to_string(one["client_generation"].get<int>());
  }();
  const auto said = ctl({"process", "revoke", client});
  EXPECT_EQ(said["schema"], "agnocast.process-revoke/1");
  EXPECT_EQ(said["processes"][0]["pid"], publisher->pid());
  ASSERT_TRUE(publisher->eventually("active", "0 0"));
  EXPECT_EQ(publisher->ask("publish 1"),
            "refused the session of this process was ended from outside");
  EXPECT_EQ(publisher->ask("matched"), "0");
  EXPECT_TRUE(publisher->eventually("events", "2 0"));
  for (const char* number : {"2", "3", "4", "5"}) EXPECT_EQ(subscriber->ask("take"), number);
  EXPECT_EQ(subscriber->ask("take"), "none");
  EXPECT_EQ(subscriber->ask("check"), "ok");
  EXPECT_EQ(subscriber->ask("drop"), "ok");
  EXPECT_TRUE(subscriber->eventually("maps", "0"));
  EXPECT_EQ(subscriber->ask("matched"), "0");
  EXPECT_EQ(publisher->finish(), 0);
}

TEST_F(Death, OfManyPublishersOfAnUnreadSubscriptionAbandonsTheOldest) {
  const DaemonOptions few{.config =
                              "[limits]\npublishers_per_topic = 6\n"
                              "[quota]\npublishers_per_topic = \"unlimited\"\n",
                          .arguments = {"--log-level", "debug"}};
  daemon_.stop();
  DaemonProcess daemon(few);
  const std::vector<std::string> own{"AGNOCAST_SOCKET=" + daemon.socket_path()};
  const std::vector<std::string> hooked{own[0], "LD_PRELOAD=" AGNOCAST_HOOK};
  SteeredProcess lazy({AGNOCAST_MORTAL}, own);
  ASSERT_EQ(lazy.ask("sub /many 100a 16"), "ok");
  const auto publish_and_die = [&] {
    SteeredProcess publisher({AGNOCAST_MORTAL}, hooked);
    std::string answer = publisher.ask("pub /many 100a");
    if (answer != "ok") return answer;
    EXPECT_TRUE(publisher.eventually("matched", "1"));
    EXPECT_EQ(publisher.ask("publish 2"), "ok");
    const pid_t pid = publisher.pid();
    publisher.kill();
    EXPECT_TRUE(is_reaped(pid, daemon));
    return answer;
  };
  constexpr int lives = 20, kept = 3;
  for (int life = 0; life < lives; ++life) ASSERT_EQ(publish_and_die(), "ok") << life;
  ASSERT_TRUE(lazy.eventually("lost", std::to_string((lives - kept) * 2)));
  // The newest are still whole, each with both of its messages.
  for (int i = 0; i < kept; ++i) {
    EXPECT_EQ(lazy.ask("take"), "1");
    EXPECT_EQ(lazy.ask("take"), "2");
  }
  EXPECT_EQ(lazy.ask("take"), "none");
  EXPECT_EQ(lazy.ask("check"), "ok");
  EXPECT_EQ(lazy.ask("drop"), "ok");
  EXPECT_TRUE(lazy.eventually("maps", "0"));

  // A holder of a message of each does not react; the daemon names it, and does not revoke it.
  const auto publish_blindly = [&] {
    SteeredProcess publisher({AGNOCAST_MORTAL}, hooked);
    const std::string answer = publisher.ask("pub /many 100a");
    const pid_t pid = publisher.pid();
    publisher.kill();
    if (answer == "ok") {
      EXPECT_TRUE(is_reaped(pid, daemon));
    }
    return answer;
  };
  for (int life = 0; life < 6; ++life) {
    ASSERT_EQ(publish_and_die(), "ok") << life;
    ASSERT_EQ(lazy.ask("take"), "1");
    ASSERT_EQ(lazy.ask("take"), "2");
  }
  const std::string refused = publish_blindly();
  EXPECT_THAT(refused, HasSubstr("publishers_per_topic is 6"));
  EXPECT_THAT(refused, HasSubstr("6 of them are gone, and process " + std::to_string(lazy.pid()) +
                                 " (system_mortal) has not unmapped 6"));
  EXPECT_EQ(lazy.ask("check"), "ok");
  EXPECT_EQ(lazy.ask("drop"), "ok");
  EXPECT_TRUE(lazy.eventually("maps", "0"));

  // A stopped process holds nothing and answers nothing: the daemon revokes it when others need
  // the room.
  ::kill(lazy.pid(), SIGSTOP);
  for (int life = 0; life < lives; ++life)
    ASSERT_TRUE(test::eventually([&] { return publish_blindly() == "ok"; })) << life;
  EXPECT_TRUE(daemon.wait_for_log("client revoked"));
  ::kill(lazy.pid(), SIGCONT);
  EXPECT_TRUE(lazy.eventually("active", "0 0"));
}

}  // namespace
}  // namespace agnocast::test
