// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process of the benchmark reports how it ended, and never outlives the benchmark. Method:
// programs that every machine has; a child killed with SIGKILL while it has a child of its own.

#include <bench/process.hpp>

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <stdexcept>
#include <thread>

namespace agnocast::bench {
namespace {

using std::chrono::seconds;

bool ends_soon(pid_t pid) {
  for (int i = 0; i < 5000 && ::kill(pid, 0) == 0; ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  return ::kill(pid, 0) != 0;
}

TEST(Process, ReportsHowItEnded) {
  EXPECT_EQ(Process({.command = {"sh", "-c", "exit 3"}}).wait(seconds(10)), 3);
  EXPECT_EQ(Process({.command = {"sh", "-c", "kill -TERM $$"}}).wait(seconds(10)), 128 + SIGTERM);
  EXPECT_EQ(Process({.command = {"/nowhere/at-all"}, .output = "/dev/null"}).wait(seconds(10)),
            127);
}

TEST(Process, TalksByLines) {
  Process echo({.command = {"sh", "-c", "while read line; do echo \"$GREETING $line\"; done"},
                .environment = {"GREETING=hello"},
                .has_pipes = true});
  EXPECT_TRUE(echo.send("one"));
  EXPECT_EQ(echo.line(), "hello one");
  EXPECT_TRUE(echo.send("two"));
  EXPECT_EQ(echo.line(), "hello two");
  EXPECT_THROW((void)echo.line(std::chrono::milliseconds(10)), std::runtime_error);
}

TEST(Process, SendingToAnEndedProcessFails) {
  const auto before = ::signal(SIGPIPE, SIG_IGN);
  Process gone({.command = {"sh", "-c", "exit 0"}, .has_pipes = true});
  EXPECT_EQ(gone.wait(seconds(10)), 0);
  EXPECT_FALSE(gone.send("hello"));
  // The child does not inherit that the caller ignores SIGPIPE.
  EXPECT_EQ(Process({.command = {"sh", "-c", "kill -PIPE $$"}}).wait(seconds(10)), 128 + SIGPIPE);
  ::signal(SIGPIPE, before);
}

TEST(Process, EndsWithItsObject) {
  pid_t pid = -1;
  {
    const Process sleeping({.command = {"sleep", "1000"}});
    pid = sleeping.pid();
    EXPECT_EQ(::kill(pid, 0), 0);
  }
  EXPECT_NE(::kill(pid, 0), 0);
}

TEST(Process, EndsWithItsParent) {
  int ends[2];
  ASSERT_EQ(::pipe(ends), 0);
  const pid_t child = ::fork();
  if (child == 0) {
    Process sleeping({.command = {"sleep", "1000"}});
    const pid_t pid = sleeping.pid();
    (void)!::write(ends[1], &pid, sizeof pid);
    ::pause();
  }
  pid_t pid = -1;
  ASSERT_EQ(::read(ends[0], &pid, sizeof pid), static_cast<ssize_t>(sizeof pid));
  ::kill(child, SIGKILL);
  ::waitpid(child, nullptr, 0);
  EXPECT_TRUE(ends_soon(pid));
  ::close(ends[0]);
  ::close(ends[1]);
}

// In its own process, because no process can be started afterwards.
TEST(Process, AllEndWhereNoDestructorRuns) {
  static const Process* client = nullptr;
  static bool is_over = false;
  const auto end_all = [] {
    Process daemon(
        {.command = {"sh", "-c", "trap 'exit 3' TERM; echo ready; while :; do sleep 0.01; done"},
         .has_pipes = true,
         .end_signal = SIGTERM,
         .at_end = [] { is_over = ::kill(client->pid(), 0) != 0; }});
    Process made({.command = {"sleep", "1000"}});
    Process moved(std::move(made));
    client = &moved;
    (void)daemon.line();
    Process::end_all();
    ::_exit(is_over && daemon.status() == 3 && moved.status() == 128 + SIGKILL ? 0 : 1);
  };
  EXPECT_EXIT(end_all(), ::testing::ExitedWithCode(0), "");
}

TEST(Role, IsFoundByName) {
  EXPECT_NE(find_role("sender"), nullptr);
  EXPECT_NE(find_role("receiver"), nullptr);
  EXPECT_NE(find_role("sender-and-receiver"), nullptr);
  EXPECT_EQ(find_role("nobody"), nullptr);
}

}  // namespace
}  // namespace agnocast::bench
