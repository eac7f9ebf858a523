// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process trusts a daemon by the uid of the listener and by which users could have put the
// socket there. Method: every kind of server and directory; directories of other users need root.

#include <base/sockets/daemon_socket.hpp>

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <regex>
#include <string>
#include <vector>

namespace agnocast {
namespace {

constexpr uid_t self = 1000, other = 1001, overflow = 65534;
bool none(uid_t) { return false; }
bool overflow_is_unknown(uid_t user) { return user == overflow; }

bool trusts(uid_t server, std::string_view named = {}, const std::string& path = "/tmp/d.sock",
            bool (*is_unknown)(uid_t) = none) {
  return is_trusted_server({server, self, named, is_unknown}, path);
}

TEST(DaemonSocket, TrustsRootItselfAndTheUserThatTheEnvironmentNames) {
  EXPECT_TRUE(trusts(0));
  EXPECT_TRUE(trusts(self));
  EXPECT_FALSE(trusts(other));
  EXPECT_TRUE(trusts(other, "1001"));
  for (const char* wrong : {"", "1002", "1001 ", "0x3e9", "-1", "10010", "all"})
    EXPECT_FALSE(trusts(other, wrong)) << wrong;
  EXPECT_FALSE(trusts(other, "", ""));
  EXPECT_FALSE(trusts(other, "", "relative/d.sock"));
}

TEST(DaemonSocket, OverflowUidIsNotTrustedAsOneUser) {
  EXPECT_TRUE(is_trusted_server({overflow, overflow, "", none}, "/tmp/d.sock"));
  EXPECT_FALSE(is_trusted_server({overflow, overflow, "", overflow_is_unknown}, "/tmp/d.sock"));
  EXPECT_TRUE(is_trusted_server({overflow, overflow, "65534", overflow_is_unknown}, "/tmp/d.sock"));
}

// Variables that a program with raised rights may read: those of a service manager and of the
// loader, and one whose presence is a reason to refuse.
TEST(DaemonSocket, IsNotNamedByAVariableThatAProgramWithRaisedRightsReads) {
  const std::vector<std::string> harmless{"LD_PRELOAD",     "ROS_DOMAIN_ID",     "FDSTORE",
                                          "NOTIFY_SOCKET",  "JOURNAL_STREAM",    "NO_COLOR",
                                          "CYCLONEDDS_URI", "RUNTIME_DIRECTORY", "WATCHDOG_USEC"};
  const std::regex plain("[^_]getenv\\(([^)]*)");
  std::size_t files = 0, secure = 0;
  for (const char* folder : {"base", "client", "heaphook", "ctl", "daemon", "bridge", "journal"}) {
    const std::filesystem::path root = std::filesystem::path(AGNOCAST_SOURCE_DIR) / folder;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(root)) {
      const std::string extension = entry.path().extension().string();
      if (extension != ".cpp" && extension != ".hpp") continue;
      ++files;
      std::ifstream file(entry.path());
      for (std::string line; std::getline(file, line);) {
        if (line.find("getenv(") == std::string::npos) continue;  // a regex takes long
        if (line.find("secure_getenv(") != std::string::npos) ++secure;
        std::smatch found;
        if (!std::regex_search(line, found, plain)) continue;
        const std::string what = found[1];
        const bool is_harmless =
            what == "name" || what == "supervisor_variable" ||  // supervisor to child
            std::any_of(harmless.begin(), harmless.end(),
                        [&](const std::string& name) { return what == '"' + name + '"'; });
        EXPECT_TRUE(is_harmless) << entry.path() << ": " << line;
        EXPECT_TRUE(what != "name" || entry.path().filename() == "supervisor.cpp") << line;
      }
    }
  }
  EXPECT_GT(files, 100u);
  EXPECT_GT(secure, 8u);
}

/// "/DIRECTORY" with the rights of the root directory: only root can write above it.
class GivenDirectory : public testing::Test {
 protected:
  void SetUp() override {
    if (::geteuid() != 0) GTEST_SKIP() << "needs root, for directories of other users";
    std::string name = "/run/agnocast-test-XXXXXX";
    if (::mkdtemp(name.data()) == nullptr) GTEST_SKIP() << "cannot make a directory in /run";
    top_ = name;
    ASSERT_EQ(::chmod(top_.c_str(), 0755), 0);
    ASSERT_EQ(::mkdir((top_ + "/d").c_str(), 0755), 0);
    ASSERT_EQ(::chown((top_ + "/d").c_str(), other, other), 0);
  }
  void TearDown() override {
    if (!top_.empty()) std::filesystem::remove_all(top_);
  }
  std::string socket() const { return top_ + "/d/agnocastd.sock"; }

  std::string top_;
};

TEST_F(GivenDirectory, VouchesForItsOwner) {
  EXPECT_TRUE(trusts(other, "", socket()));
  EXPECT_FALSE(trusts(other + 1, "", socket())) << "another user listens there";
  EXPECT_FALSE(trusts(other, "", top_ + "/d/no/agnocastd.sock"));
}

TEST_F(GivenDirectory, IsNotTrustedWhereOthersMayWrite) {
  ASSERT_EQ(::chmod((top_ + "/d").c_str(), 0777), 0);
  EXPECT_FALSE(trusts(other, "", socket()));
  ASSERT_EQ(::chmod((top_ + "/d").c_str(), 0775), 0);
  EXPECT_FALSE(trusts(other, "", socket()));
  ASSERT_EQ(::chmod((top_ + "/d").c_str(), 0755), 0);
  ASSERT_EQ(::chmod(top_.c_str(), 01777), 0);
  EXPECT_FALSE(trusts(other, "", socket())) << "any user may have created the socket there";
}

TEST_F(GivenDirectory, IsNotTrustedThroughLinks) {
  ASSERT_EQ(::symlink((top_ + "/d").c_str(), (top_ + "/link").c_str()), 0);
  EXPECT_FALSE(trusts(other, "", top_ + "/link/agnocastd.sock"));
  EXPECT_FALSE(trusts(other, "", top_ + "/./d/agnocastd.sock"));
}

TEST_F(GivenDirectory, IsNotTrustedBelowADirectoryOfAnotherUser) {
  ASSERT_EQ(::chown(top_.c_str(), other, other), 0);
  EXPECT_FALSE(trusts(other, "", socket()));
  // A user namespace has no uid for the machine's root; the user that mounted it decided.
  ASSERT_EQ(::chown(top_.c_str(), overflow, overflow), 0);
  EXPECT_FALSE(trusts(other, "", socket()));
  EXPECT_TRUE(trusts(other, "", socket(), overflow_is_unknown));
}

}  // namespace
}  // namespace agnocast
