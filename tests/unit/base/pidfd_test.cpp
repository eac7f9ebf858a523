// SPDX-License-Identifier: Apache-2.0
//
// Goal: a Pidfd reports the end of exactly its process, and identities distinguish processes.
// Method: forked children, killed.

#include <base/descriptors/pidfd.hpp>

#include "tests/support/memory/descriptors.hpp"
#include "tests/support/processes/child.hpp"

#include <gtest/gtest.h>

#include <poll.h>
#include <sched.h>
#include <sys/prctl.h>
#include <sys/vfs.h>

#include <cerrno>

namespace agnocast {
namespace {

using test::Child;
using test::sleep_for_ever;

TEST(Pidfd, BecomesReadableWhenTheProcessIsKilled) {
  Child child(sleep_for_ever);
  const auto process = Pidfd::open(child.pid());
  ASSERT_TRUE(process);
  EXPECT_TRUE(test::is_close_on_exec(process->fd()));
  EXPECT_FALSE(process->ended());
  child.kill();
  pollfd entry{process->fd(), POLLIN, 0};
  EXPECT_EQ(::poll(&entry, 1, 10'000), 1);
  EXPECT_TRUE(process->ended()) << "a zombie has ended";
  child.wait();
  EXPECT_TRUE(process->ended()) << "a reaped process has ended";
}

TEST(Pidfd, AReapedProcessHasNone) {
  Child child([] { return 0; });
  const pid_t pid = child.pid();
  child.wait();
  const auto process = Pidfd::open(pid);
  ASSERT_FALSE(process);
  EXPECT_EQ(process.error().os_errno, ESRCH);
}

TEST(Pidfd, InodeIdentifiesTheProcess) {
  Child first(sleep_for_ever);
  Child second(sleep_for_ever);
  const auto one = Pidfd::open(first.pid());
  const auto again = Pidfd::open(first.pid());
  const auto other = Pidfd::open(second.pid());
  ASSERT_TRUE(one && again && other);
  constexpr auto pidfs_magic = 0x50494446;  // PIDFS_MAGIC of linux/magic.h
  struct statfs filesystem {};
  ASSERT_EQ(::fstatfs(one->fd(), &filesystem), 0);
  if (filesystem.f_type != pidfs_magic) GTEST_SKIP() << "pidfds have inodes since Linux 6.9";
  EXPECT_TRUE(one->inode());
  EXPECT_EQ(one->inode(), again->inode());
  EXPECT_NE(one->inode(), other->inode());
  EXPECT_FALSE(Pidfd(UniqueFd(::dup(0))).inode()) << "not a pidfd";
}

TEST(Pidfd, ProcessesAreDistinguishedAndADeadOneEqualsNone) {
  Child first(sleep_for_ever);
  Child second(sleep_for_ever);
  const auto one = Pidfd::open(first.pid());
  const auto again = Pidfd::open(first.pid());
  const auto other = Pidfd::open(second.pid());
  ASSERT_TRUE(one && again && other);
  for (const bool has_inodes : {true, false}) {
    EXPECT_TRUE(same_process(*one, *again, has_inodes));
    EXPECT_FALSE(same_process(*one, *other, has_inodes));
    EXPECT_FALSE(same_process(*one, Pidfd(UniqueFd(::dup(0))), has_inodes));
  }
  first.kill();
  first.wait();
  for (const bool has_inodes : {true, false}) EXPECT_FALSE(same_process(*one, *again, has_inodes));
}

TEST(Pidfd, StartTimeIsStableAndADeadProcessHasNone) {
  Child child(sleep_for_ever);
  const auto own = start_time_of(::getpid());
  const auto its = start_time_of(child.pid());
  ASSERT_TRUE(own && its);
  EXPECT_GT(*own, 0U);
  EXPECT_GE(*its, *own);
  EXPECT_EQ(start_time_of(child.pid()), its);
  const pid_t pid = child.pid();
  child.kill();
  child.wait();
  EXPECT_FALSE(start_time_of(pid));
}

// A process name in /proc/PID/stat may contain spaces and parentheses.
TEST(Pidfd, StartTimeSurvivesAHostileProcessName) {
  Child child([] {
    const auto plain = start_time_of(::getpid());
    if (::prctl(PR_SET_NAME, "a) R 1 (b) 2", 0, 0, 0) != 0) return 1;
    return plain && start_time_of(::getpid()) == plain ? 0 : 2;
  });
  EXPECT_EQ(child.wait(), 0);
}

TEST(Pidfd, UserNamespaceTellsContainersApart) {
  const auto own = user_namespace_of(::getpid());
  ASSERT_TRUE(own);
  const auto self = Pidfd::open(::getpid());
  ASSERT_TRUE(self);
  EXPECT_EQ(self->user_namespace().value_or(*own), *own) << "unknown before Linux 6.11";
  Child same([&] { return user_namespace_of(::getpid()) == own ? 0 : 1; });
  EXPECT_EQ(same.wait(), 0);
  Child other([&] {
    if (::unshare(CLONE_NEWUSER) != 0) return 77;
    const auto its = user_namespace_of(::getpid());
    return its && its != own ? 0 : 1;
  });
  const int status = other.wait();
  if (status == 77) GTEST_SKIP() << "needs the right to create user namespaces";
  EXPECT_EQ(status, 0);
}

}  // namespace
}  // namespace agnocast
