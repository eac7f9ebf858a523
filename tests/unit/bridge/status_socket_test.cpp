// SPDX-License-Identifier: Apache-2.0
//
// Goal: the bridge makes its status socket only where no other user can replace it, and neither
// uses nor changes a file that another user put there first. Method: directories and files of such
// kinds, some of another user; what StatusSocket says about them, and that they are unchanged.
// integration_bridge_ctl tests the answers to clients.

#include <bridge/program/status_socket.hpp>

#include <tests/support/machine/temporary_directory.hpp>

#include <gtest/gtest.h>

#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

namespace agnocast::bridge {
namespace {

constexpr uid_t other_uid = 65534;

class StatusSocketPlace : public testing::Test {
 protected:
  /// Returns what is wrong with the place; empty if nothing is.
  std::string refusal() const {
    const auto taken = StatusSocket::take(path_);
    if (taken) return "";
    EXPECT_FALSE(taken.error().is_taken);
    return taken.error().why;
  }
  bool is_empty() const { return std::filesystem::is_empty(directory_.path()); }

  test::TemporaryDirectory directory_;
  const std::string path_ = directory_.path("bridge-0.sock"), lock_ = path_ + ".lock";
};

std::string content_of(const std::string& path) {
  std::string text;
  std::getline(std::ifstream(path), text);
  return text;
}

TEST_F(StatusSocketPlace, BelongsToOneBridge) {
  const auto first = StatusSocket::take(path_);
  ASSERT_TRUE(first) << first.error().why;
  const auto second = StatusSocket::take(path_);
  ASSERT_FALSE(second);
  EXPECT_TRUE(second.error().is_taken);
  EXPECT_EQ(second.error().why, lock_ + " is locked");
}

TEST_F(StatusSocketPlace, IsRefusedWhereTheLockIsALink) {
  const std::string precious = directory_.path("precious");
  std::ofstream(precious) << "1234567";
  for (const char* target : {"precious", "not there"}) {
    ASSERT_EQ(::symlink(target, lock_.c_str()), 0);
    EXPECT_EQ(refusal(), lock_ + ": it is a symbolic link");
    ASSERT_EQ(::unlink(lock_.c_str()), 0);
  }
  EXPECT_EQ(content_of(precious), "1234567");
  EXPECT_FALSE(std::filesystem::exists(directory_.path("not there")));
}

TEST_F(StatusSocketPlace, IsRefusedWhereTheLockBelongsToAnotherUser) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  std::ofstream(lock_) << "another's";
  ASSERT_EQ(::chown(lock_.c_str(), other_uid, other_uid), 0);
  EXPECT_EQ(refusal(), lock_ + ": it is not a file of this user");
  // In a world-writable sticky directory the kernel may refuse first (fs.protected_regular).
  ASSERT_EQ(::chmod(directory_.path().c_str(), 01777), 0);
  const std::string refused = refusal();
  EXPECT_TRUE(refused == lock_ + ": it is not a file of this user" ||
              refused == lock_ + ": Permission denied")
      << refused;
  EXPECT_EQ(content_of(lock_), "another's");
}

TEST_F(StatusSocketPlace, IsRefusedInADirectoryOfAnotherUser) {
  if (::geteuid() != 0) GTEST_SKIP() << "needs root";
  ASSERT_EQ(::chown(directory_.path().c_str(), other_uid, other_uid), 0);
  EXPECT_EQ(refusal(), "cannot use directory " + directory_.path() + ": user " +
                           std::to_string(other_uid) + " owns it and could replace the socket");
  EXPECT_TRUE(is_empty());
}

TEST_F(StatusSocketPlace, IsRefusedWhereOthersMayRemoveNames) {
  for (const mode_t mode : {0777u, 0775u}) {
    ASSERT_EQ(::chmod(directory_.path().c_str(), mode), 0);
    EXPECT_EQ(refusal(), "cannot use directory " + directory_.path() +
                             ": others may write there and could replace the socket");
    EXPECT_TRUE(is_empty());
  }
  ASSERT_EQ(::chmod(directory_.path().c_str(), 01777), 0);
  EXPECT_EQ(refusal(), "") << "in a sticky directory only the owner can remove a name";
}

TEST_F(StatusSocketPlace, IsRefusedWhereThereIsNoDirectory) {
  const std::string nowhere = directory_.path("nowhere");
  auto taken = StatusSocket::take(nowhere + "/bridge-0.sock");
  ASSERT_FALSE(taken);
  EXPECT_EQ(taken.error().why, "cannot use directory " + nowhere + ": No such file or directory");
  std::ofstream(nowhere) << "a file";
  taken = StatusSocket::take(nowhere + "/bridge-0.sock");
  ASSERT_FALSE(taken);
  EXPECT_EQ(taken.error().why, "cannot use " + nowhere + ": it is not a directory");
}

TEST_F(StatusSocketPlace, ALinkInPlaceOfTheSocketIsReplacedNotFollowed) {
  const std::string precious = directory_.path("precious");
  std::ofstream(precious) << "1234567";
  ASSERT_EQ(::chmod(precious.c_str(), 0600), 0);
  ASSERT_EQ(::symlink("precious", path_.c_str()), 0);
  const auto taken = StatusSocket::take(path_);
  ASSERT_TRUE(taken) << taken.error().why;
  const auto listens = (*taken)->listen([] { return std::string("here"); });
  ASSERT_TRUE(listens) << listens.error().why;
  struct stat file {};
  ASSERT_EQ(::lstat(path_.c_str(), &file), 0);
  EXPECT_TRUE(S_ISSOCK(file.st_mode));
  EXPECT_EQ(file.st_mode & 07777, 0660u);
  ASSERT_EQ(::lstat(precious.c_str(), &file), 0);
  EXPECT_EQ(file.st_mode & 07777, 0600u);
  EXPECT_EQ(content_of(precious), "1234567");
}

}  // namespace
}  // namespace agnocast::bridge
