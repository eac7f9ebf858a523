// SPDX-License-Identifier: Apache-2.0
//
// Goal: a program with endpoints may do anything to its own process: user code that the library
// runs has the signal mask of the endpoint's creator, threads may end in any way, and the process
// ends as without the library.
// Method: a program (process_node.cpp) that does it, with the real daemon; its output and its end.

#include <base/descriptors/unique_fd.hpp>
#include <base/sockets/unix_address.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/steered_process.hpp>

#include <gmock/gmock.h>

#include <fcntl.h>
#include <sys/socket.h>

#include <csignal>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

/// A node's output, and its end: its status, or minus a signal.
struct End {
  std::vector<std::string> said;
  int status = 0;
};

class Process : public testing::Test {
 protected:
  End run(const std::string& what, const std::string& how = "") {
    return run_at(daemon_.socket_path(), {what, how});
  }
  static End run_at(const std::string& socket, std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), AGNOCAST_PROCESS_NODE);
    test::SteeredProcess node(arguments, {"AGNOCAST_SOCKET=" + socket});
    End end;
    for (;;) {
      std::string line = node.answer(90);
      if (line == "(it has ended)") {
        end.status = node.finish();
        return end;
      }
      end.said.push_back(line);
      if (line.front() != '(') continue;
      node.kill();
      end.status = -1000;
      return end;
    }
  }
  test::DaemonProcess daemon_;
};

// --- signals

class SignalsIn : public Process, public testing::WithParamInterface<const char*> {};

TEST_P(SignalsIn, AreThoseOfTheEndpointsCreator) {
  const std::string usr1 = "0000000000000200";
  const End end = run("signals", GetParam());
  EXPECT_THAT(end.said, ElementsAre("here " + usr1 + " thread " + usr1 + " child " + usr1));
  EXPECT_EQ(end.status, 0);
}
INSTANTIATE_TEST_SUITE_P(Process, SignalsIn,
                         testing::Values("callback", "event", "request", "response", "destructor",
                                         "closure"),
                         [](const auto& place) { return std::string(place.param); });

TEST_F(Process, IsEndedByASignalThatACallbackRaises) {
  const End end = run("raise");
  EXPECT_THAT(end.said, IsEmpty());
  EXPECT_EQ(end.status, -SIGTERM);
}

TEST_F(Process, IsNotInterruptedInSleepingThreadsOfTheLibrary) {
  EXPECT_THAT(run("asleep").said,
              ElementsAre("agnocast-call yes agnocast-ctl yes agnocast-srv yes "));
}

// --- ends of threads

TEST_F(Process, EndsWithItsMainThreadIfThatIsTheLast) {
  const End end = run("main_ends", "nothing");
  EXPECT_THAT(end.said, ElementsAre("main ends", "exit handlers, 0000000000000200"));
  EXPECT_EQ(end.status, 0);
}

TEST_F(Process, LivesAsLongAsAThreadOfTheUser) {
  const End end = run("main_ends", "worker");
  EXPECT_THAT(end.said,
              ElementsAre("main ends", "the callbacks go on", "exit handlers, 0000000000000200"));
  EXPECT_EQ(end.status, 0);
}

TEST_F(Process, LivesAsLongAsACallbackRuns) {
  const End end = run("main_ends", "callback");
  EXPECT_THAT(end.said, ElementsAre("main ends", "the callback has ended",
                                    "exit handlers, 0000000000000200"));
  EXPECT_EQ(end.status, 0);
}

TEST_F(Process, EndsAlthoughItsCallbacksFollowEachOther) {
  const End end = run("main_ends", "busy");
  EXPECT_THAT(end.said, ElementsAre("main ends", "exit handlers, 0000000000000200"));
  EXPECT_EQ(end.status, 0);
}

class ThreadEndsIn : public Process, public testing::WithParamInterface<const char*> {};

TEST_P(ThreadEndsIn, AndTheNodeGoesOn) {
  const End end = run("callback_ends", GetParam());
  EXPECT_THAT(end.said, ElementsAre("the next one runs"));
  EXPECT_EQ(end.status, 0);
}
INSTANTIATE_TEST_SUITE_P(Process, ThreadEndsIn,
                         testing::Values("callback", "event", "request", "response"),
                         [](const auto& place) { return std::string(place.param); });

TEST_F(Process, GoesOnWhenACallbacksThreadIsCancelled) {
  const End end = run("callback_cancelled");
  EXPECT_THAT(end.said, ElementsAre("the next one runs"));
  EXPECT_EQ(end.status, 0);
}

// --- waits

TEST_F(Process, EndsAlthoughACallbackOfAStaticSubscriptionNeverEnds) {
  for (const char* const where : {"before", "after"}) {
    const End end = run("endless", where);
    EXPECT_THAT(end.said, ElementsAre("main returns")) << where;
    EXPECT_EQ(end.status, 7) << where;
  }
}

TEST_F(Process, GoesOnWhenTwoCallbacksDestroyEachOther) {
  const End end = run("mutual");
  EXPECT_THAT(end.said, ElementsAre("both are destroyed"));
  EXPECT_EQ(end.status, 0);
}

// --- descriptors

class Closes : public Process, public testing::WithParamInterface<const char*> {};

TEST_P(Closes, TheLibrarysDescriptorsAndKeepsItsOwn) {
  const End end = run("closes", GetParam());
  EXPECT_THAT(end.said,
              ElementsAre("os_failure", "callbacks go on", "os_failure", "files are untouched"));
  EXPECT_EQ(end.status, 0);
}
INSTANTIATE_TEST_SUITE_P(Process, Closes, testing::Values("low", "same"),
                         [](const auto& where) { return std::string(where.param); });

TEST_F(Process, KeepsItsFilesInAForkedChild) {
  const End end = run("closes", "forked");
  EXPECT_THAT(end.said, ElementsAre("files are untouched"));
  EXPECT_EQ(end.status, 0);
}

// --- the daemon's socket

TEST_F(Process, ReconnectsByARelativePathFromAnotherDirectory) {
  const std::string& path = daemon_.socket_path();
  const std::size_t slash = path.rfind('/');
  test::SteeredProcess node({AGNOCAST_PROCESS_NODE, "relative", path.substr(0, slash)},
                            {"AGNOCAST_SOCKET=" + path.substr(slash + 1)});
  ASSERT_EQ(node.answer(), "connected");
  daemon_.kill_worker();
  EXPECT_EQ(node.answer(60), "connected again");
}

class Begins : public Process {
 protected:
  std::string elsewhere(const std::string& name) const { return daemon_.directory() + "/" + name; }
  /// Leaves a socket whose owner is dead.
  void leave_socket(const std::string& path) const {
    const UniqueFd fd(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
    const auto address = unix_address(path);
    ASSERT_TRUE(address);
    ASSERT_EQ(::bind(fd.get(), address->get(), UnixAddress::size()), 0);
  }
};

TEST_F(Begins, WhileTheDaemonRestarts) {
  leave_socket(elsewhere("one"));
  EXPECT_THAT(run_at(elsewhere("one"), {"begins", daemon_.socket_path(), elsewhere("one")}).said,
              ElementsAre("connected", "1 refusals"));
  ASSERT_EQ(std::rename(elsewhere("one").c_str(), daemon_.socket_path().c_str()), 0);
  UniqueFd(::open(elsewhere("two.lock").c_str(), O_CREAT | O_WRONLY | O_CLOEXEC, 0600));
  EXPECT_THAT(run_at(elsewhere("two"), {"begins", daemon_.socket_path(), elsewhere("two")}).said,
              ElementsAre("connected", "1 refusals"));
}

TEST_F(Begins, OrFailsIfNobodyListens) {
  leave_socket(elsewhere("one"));
  EXPECT_THAT(run_at(elsewhere("one"), {"begins"}).said,
              ElementsAre("daemon_not_running", "more refusals"));
  // No sign that a daemon was ever there: the error comes at once.
  EXPECT_THAT(run_at(elsewhere("two"), {"begins"}).said,
              ElementsAre("daemon_not_running", "1 refusals"));
}

}  // namespace
}  // namespace agnocast
