// SPDX-License-Identifier: Apache-2.0
//
// An agnocastd of the test, for tests of what happens without it or with little memory.
#pragma once

#include "common.hpp"

#include <signal.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

namespace agnocastlib {

/// Serves this process, which has not used agnocast yet, from the constructor on.
class Daemon {
 public:
  /// `config`: the content of agnocastd.toml.
  explicit Daemon(const std::string& config = "") {
    char made[] = "/tmp/agnocastlib.XXXXXX";
    if (::mkdtemp(made) == nullptr) std::abort();
    folder_ = made;
    const std::string socket = folder_ / "socket", file = folder_ / "agnocastd.toml";
    std::ofstream(file) << config;
    ::setenv("AGNOCAST_SOCKET", socket.c_str(), 1);
    pid_ = ::fork();
    if (pid_ == 0) {
      ::unsetenv("LD_PRELOAD");
      ::execlp("agnocastd", "agnocastd", "--foreground", "--socket", socket.c_str(), "--config",
               file.c_str(), nullptr);
      ::_exit(127);
    }
    struct stat found;
    EXPECT_TRUE(eventually([&] { return ::stat(socket.c_str(), &found) == 0; }));
  }
  ~Daemon() {
    stop();
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  Daemon(const Daemon&) = delete;
  Daemon& operator=(const Daemon&) = delete;

  /// Ends agnocastd and its supervisor.
  void stop() {
    if (pid_ < 0) return;
    ::kill(pid_, SIGTERM);
    EXPECT_EQ(::waitpid(pid_, nullptr, 0), pid_);
    pid_ = -1;
  }

 private:
  std::filesystem::path folder_;
  pid_t pid_ = -1;
};

}  // namespace agnocastlib
