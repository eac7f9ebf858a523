// SPDX-License-Identifier: Apache-2.0
//
// Goal: the demo passes when everything is right, fails when one byte of one message is wrong, and
// leaves neither a process nor a file behind, however it ends. Method: run its main job against
// the built tree with a temporary directory of its own. This program adopts all processes that the
// demo leaves (PR_SET_CHILD_SUBREAPER), so that none can hide.

#include <base/descriptors/unique_fd.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fcntl.h>
#include <netinet/in.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

using testing::HasSubstr;
using testing::Not;

class Demo : public testing::Test {
 protected:
  Demo() {
    ::prctl(PR_SET_CHILD_SUBREAPER, 1);
    std::string path = testing::TempDir() + "agnocast-demo-test-XXXXXX";
    directory_ = ::mkdtemp(path.data()) != nullptr ? path : std::string();
  }
  ~Demo() override {
    if (pid_ > 0) ::kill(pid_, SIGKILL);
    ::close(output_);
    EXPECT_TRUE(all_processes_end());
    std::filesystem::remove_all(directory_);
  }

  void start(std::vector<std::string> options, const char* daemon = AGNOCAST_TEST_DAEMON) {
    options.insert(options.begin(),
                   {AGNOCAST_DEMO, "--agnocastd", daemon, "--hook", AGNOCAST_HOOK});
    std::vector<char*> arguments;
    for (std::string& option : options) arguments.push_back(option.data());
    arguments.push_back(nullptr);
    int ends[2];
    ASSERT_EQ(::pipe2(ends, O_CLOEXEC), 0);
    pid_ = ::fork();
    ASSERT_GE(pid_, 0);
    if (pid_ == 0) {
      ::setenv("TMPDIR", directory_.c_str(), 1);
      ::dup2(ends[1], STDOUT_FILENO);
      ::dup2(ends[1], STDERR_FILENO);
      ::execv(arguments[0], arguments.data());
      ::_exit(127);
    }
    ::close(ends[1]);
    output_ = ends[0];
  }

  /// Appends the demo's output to text_; returns false at its end.
  bool read_some() {
    char bytes[4096];
    const ssize_t count = ::read(output_, bytes, sizeof bytes);
    if (count <= 0) return false;
    text_.append(bytes, static_cast<std::size_t>(count));
    return true;
  }

  bool read_until(const std::string& text) {
    while (text_.find(text) == std::string::npos)
      if (!read_some()) return false;
    return true;
  }

  /// Returns its exit status, 128 + N after signal N; text_ holds its whole output.
  int finish() {
    while (read_some()) continue;
    int status = 0;
    EXPECT_EQ(::waitpid(pid_, &status, 0), pid_);
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }

  /// Returns the length in characters of UTF-8.
  std::size_t longest_line() const {
    std::size_t longest = 0, columns = 0;
    for (const char c : text_) {
      columns = c == '\n' ? 0 : columns + ((static_cast<unsigned char>(c) & 0xc0) != 0x80);
      longest = std::max(longest, columns);
    }
    return longest;
  }

  static bool all_processes_end() {
    for (int attempt = 0; attempt < 2000; ++attempt) {
      if (::waitpid(-1, nullptr, WNOHANG) < 0) return errno == ECHILD;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return false;
  }

  std::string directory_;
  std::string text_;
  pid_t pid_ = -1;
  int output_ = -1;
};

/// Takes the ports of the first ten participants of DDS domain 0 (RTPS 2.3, 9.6.1.1), as many as
/// Cyclone DDS tries by default; those that are in use are taken.
std::vector<UniqueFd> full_domain() {
  std::vector<UniqueFd> taken;
  for (std::uint16_t port = 7410; port < 7430; ++port) {
    taken.emplace_back(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    const auto* const any = reinterpret_cast<const sockaddr*>(&address);
    EXPECT_TRUE(::bind(taken.back().get(), any, sizeof address) == 0 || errno == EADDRINUSE);
  }
  return taken;
}

TEST_F(Demo, PassesWhenEveryMessageArrivesIntact) {
  const auto taken = full_domain();
  start({"--quick"});
  EXPECT_EQ(finish(), 0) << text_;
  EXPECT_THAT(text_, Not(HasSubstr("Cyclone DDS does not start")));
  EXPECT_THAT(text_, HasSubstr("PASSED: every message arrived intact"));
  EXPECT_THAT(text_, HasSubstr("checked for all 50 messages"));
  EXPECT_THAT(text_, HasSubstr("scope loan  adopted_bytes 1048576"));
  EXPECT_THAT(text_, HasSubstr("scope all   adopted_bytes       0"));
  EXPECT_THAT(text_, HasSubstr("latency, p50, logarithmic"));
  EXPECT_LE(longest_line(), 80u) << text_;
  EXPECT_TRUE(all_processes_end());
  EXPECT_TRUE(std::filesystem::is_empty(directory_));
}

TEST_F(Demo, FailsWhenOneByteOfOneMessageIsWrong) {
  start({"--quick", "--no-dds", "--corrupt-one"});
  EXPECT_EQ(finish(), 1) << text_;
  EXPECT_THAT(text_, HasSubstr("at subscriber 1 is not what was sent: its checksum differs"));
  EXPECT_THAT(text_, HasSubstr("at subscriber 2 is not what was sent: its checksum differs"));
  EXPECT_THAT(text_, HasSubstr("100 KB   10 messages  NOT ALL INTACT"));
  EXPECT_THAT(text_, HasSubstr("FAILED"));
  EXPECT_THAT(text_, Not(HasSubstr("PASSED")));
}

TEST_F(Demo, LeavesNothingBehindWhenItIsInterrupted) {
  start({"--seconds", "600"});
  ASSERT_TRUE(read_until("[4] latency")) << text_;
  ASSERT_EQ(::kill(pid_, SIGINT), 0);
  EXPECT_EQ(finish(), 128 + SIGINT) << text_;
  EXPECT_TRUE(all_processes_end());
  EXPECT_TRUE(std::filesystem::is_empty(directory_));
}

TEST_F(Demo, LeavesNoProcessWhenItIsKilled) {
  start({"--seconds", "600"});
  ASSERT_TRUE(read_until("[2] no byte moved")) << text_;
  ASSERT_EQ(::kill(pid_, SIGKILL), 0);
  EXPECT_EQ(finish(), 128 + SIGKILL);
  EXPECT_TRUE(all_processes_end());
}

TEST_F(Demo, PrintsTheDaemonsErrorWhenItDoesNotStart) {
  start({"--quick"}, "/bin/false");
  EXPECT_EQ(finish(), 1);
  EXPECT_THAT(text_, HasSubstr("agnocastd does not serve"));
  EXPECT_TRUE(std::filesystem::is_empty(directory_));
}

class WrongUsage : public Demo, public testing::WithParamInterface<const char*> {};

TEST_P(WrongUsage, IsRefusedWithStatusTwo) {
  std::vector<std::string> words;
  std::istringstream line(GetParam());
  for (std::string word; line >> word;) words.push_back(word);
  start(words);
  EXPECT_EQ(finish(), 2);
  EXPECT_THAT(text_, HasSubstr("hint: scripts/demo --help"));
}

INSTANTIATE_TEST_SUITE_P(Options, WrongUsage,
                         testing::Values("--bogus", "--seconds", "--seconds 0", "--seconds soon",
                                         "--seconds 5x", "--seconds nan", "quick"));

}  // namespace
}  // namespace agnocast
