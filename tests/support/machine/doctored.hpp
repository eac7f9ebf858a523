// SPDX-License-Identifier: Apache-2.0
//
// Doctored: runs agnocast-ctl doctor as a user does, returns its findings, and runs its remedies
// in a shell.
//
// The host looks the same on every machine: doctor runs in its own mount namespace, where files of
// the test cover those of /sys and /proc. Nothing of the host is changed.
#pragma once

#include <tests/support/machine/raised_limits.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/soon.hpp>

#include <gtest/gtest.h>
#include <sched.h>
#include <signal.h>
#include <sys/mount.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <fstream>
#include <map>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::test {

/// Files of the test instead of the host's: path and content.
using Overlay = std::map<std::string, std::string>;

inline constexpr const char* shmem_enabled = "/sys/kernel/mm/transparent_hugepage/shmem_enabled";

struct Findings {
  /// "id: what", for each that is not ok.
  std::vector<std::string> all;
  std::vector<std::string> remedies;  // of each
  CtlResult result;

  std::vector<std::string> ids() const {
    std::vector<std::string> ids;
    for (const std::string& one : all) ids.push_back(one.substr(0, one.find(':')));
    return ids;
  }
};

class Doctored {
 public:
  explicit Doctored(std::string socket) : socket_(std::move(socket)), directory_(make_directory()) {
    overlay_[shmem_enabled] = "always [advise] never\n";
  }
  ~Doctored() { remove_directory(directory_); }
  Doctored(const Doctored&) = delete;
  Doctored& operator=(const Doctored&) = delete;

  /// Returns whether this process may have a mount namespace. Without one, the host is used.
  static bool has_namespaces() { return ::geteuid() == 0; }

  Overlay& overlay() { return overlay_; }
  /// Directories to bind over others; both must exist, except below /run, which is then empty.
  std::map<std::string, std::string>& directories() { return directories_; }
  void set_user(uid_t uid) { uid_ = uid; }

  /// Runs any command as doctor is run.
  CtlResult run(const std::vector<std::string>& words, std::vector<std::string> environment = {}) {
    environment.push_back("PATH=" AGNOCAST_TEST_PATH ":/usr/sbin:/usr/bin:/sbin:/bin");
    return run_ctl(socket_, words, environment, uid_, nullptr, [this] { enter(); });
  }
  Findings look(std::vector<std::string> environment = {}, std::vector<std::string> words = {}) {
    words.insert(words.begin(), {"doctor", "-j"});
    Findings findings;
    findings.result = run(words, std::move(environment));
    if (findings.result.out.empty()) return findings;
    const auto report = findings.result.json();
    EXPECT_EQ(report["schema"], "agnocast.doctor/1");
    for (const auto& check : report["checks"]) {
      for (const auto& finding : check["findings"]) {
        findings.all.push_back(check["id"].get<std::string>() + ": " +
                               finding["what"].get<std::string>());
        findings.remedies.push_back(finding["remedy"]);
      }
    }
    return findings;
  }

 private:
  // Runs in the child that becomes agnocast-ctl.
  void enter() const {
    if (!has_namespaces()) return;
    if (::unshare(CLONE_NEWNS) != 0 ||
        ::mount(nullptr, "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0)
      ::_exit(97);
    int number = 0;
    for (const auto& [path, text] : overlay_) {
      const std::string file = directory_ + '/' + std::to_string(number++);
      std::ofstream(file) << text;
      ::mount(file.c_str(), path.c_str(), nullptr, MS_BIND, nullptr);
    }
    if (directories_.empty()) return;
    if (::mount("none", "/run", "tmpfs", 0, "mode=0755") != 0) ::_exit(96);
    for (const auto& [path, source] : directories_) {
      for (std::size_t at = path.find('/', 1); at != std::string::npos; at = path.find('/', at + 1))
        ::mkdir(path.substr(0, at).c_str(), 0755);
      ::mkdir(path.c_str(), 0755);
      if (::mount(source.c_str(), path.c_str(), nullptr, MS_BIND, nullptr) != 0) ::_exit(95);
    }
  }

  std::string socket_, directory_;
  Overlay overlay_;
  std::map<std::string, std::string> directories_;
  std::optional<uid_t> uid_;
};

/// A remedy, run by a shell as the test's user (so without sudo); the processes that it leaves
/// running end with this object.
class Remedy {
 public:
  explicit Remedy(std::string command, std::vector<std::string> environment = {}) {
    for (std::size_t at = 0; (at = command.find("sudo ", at)) != std::string::npos;)
      command.erase(at, 5);
    environment.push_back("PATH=" AGNOCAST_TEST_PATH ":/usr/sbin:/usr/bin:/sbin:/bin");
    pid_ = ::fork();
    if (pid_ != 0) {
      int status = 0;
      ::waitpid(pid_, &status, 0);
      status_ = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
      return;
    }
    ::setpgid(0, 0);
    for (const std::string& variable : environment) ::putenv(const_cast<char*>(variable.c_str()));
    // None of our descriptors: a remaining process would keep a pipe of the test open.
    ::close_range(3, ~0U, CLOSE_RANGE_CLOEXEC);
    ::execl("/bin/sh", "sh", "-c", command.c_str(), nullptr);
    ::_exit(98);
  }
  ~Remedy() { ::kill(-pid_, SIGKILL); }
  Remedy(const Remedy&) = delete;
  Remedy& operator=(const Remedy&) = delete;

  int status() const { return status_; }

 private:
  pid_t pid_ = -1;
  int status_ = -1;
};

}  // namespace agnocast::test
