// SPDX-License-Identifier: Apache-2.0
//
// run_ctl: agnocast-ctl as a user runs it: words in, status and both outputs out.
#pragma once

#include <base/descriptors/unique_fd.hpp>
#include <tests/support/json_judge.hpp>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <fcntl.h>
#include <grp.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::test {

struct CtlResult {
  int status = -1;
  std::string out;
  std::string err;
  /// Returns the single object that --json printed.
  nlohmann::json json() const {
    auto parsed = nlohmann::json::parse(out, nullptr, false);
    EXPECT_FALSE(parsed.is_discarded()) << out << err;
    return parsed;
  }
};

/// `environment` has "NAME=value"; `uid`: run as this user (the test must be root); `out_path`: a
/// file for stdout; `before` runs in its process, as the test's user.
inline CtlResult run_ctl(const std::string& socket, std::vector<std::string> words,
                         const std::vector<std::string>& environment = {},
                         std::optional<uid_t> uid = {}, const char* out_path = nullptr,
                         const std::function<void()>& before = {}) {
  const auto temporary = [] {
    std::FILE* const file = std::tmpfile();
    const UniqueFd fd(::dup(::fileno(file)));
    std::fclose(file);
    return UniqueFd(::fcntl(fd.get(), F_DUPFD_CLOEXEC, 10));
  };
  const UniqueFd out = temporary(), err = temporary();
  words.insert(words.begin(), AGNOCAST_TEST_CTL);
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  // Another user may have no access to the program's directory.
  const UniqueFd program(::open(AGNOCAST_TEST_CTL, O_PATH | O_CLOEXEC));
  const pid_t pid = ::fork();
  if (pid == 0) {
    ::unsetenv("ROS_DOMAIN_ID");
    ::setenv("AGNOCAST_SOCKET", socket.c_str(), 1);
    for (const std::string& variable : environment) ::putenv(const_cast<char*>(variable.c_str()));
    ::dup2(out_path == nullptr ? out.get() : ::open(out_path, O_WRONLY | O_CLOEXEC), STDOUT_FILENO);
    ::dup2(err.get(), STDERR_FILENO);
    if (before) before();
    if (uid && (::setgroups(0, nullptr) != 0 || ::setgid(*uid) != 0 || ::setuid(*uid) != 0))
      ::_exit(99);
    if (uid) ::fexecve(program.get(), arguments.data(), environ);
    ::execv(arguments[0], arguments.data());
    ::_exit(98);
  }
  CtlResult result;
  int status = 0;
  ::waitpid(pid, &status, 0);
  result.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  for (const auto& [fd, text] : {std::pair(&out, &result.out), std::pair(&err, &result.err)}) {
    char buffer[4096];
    for (off_t at = 0;;) {
      const ssize_t count = ::pread(fd->get(), buffer, sizeof buffer, at);
      if (count <= 0) break;
      text->append(buffer, static_cast<std::size_t>(count));
      at += count;
    }
  }
  const bool is_json = std::any_of(words.begin(), words.end(), [](const std::string& word) {
    return word == "-j" || word.find("json") != std::string::npos;
  });
  if (is_json && result.out.starts_with('{')) judge_json(result.out);
  return result;
}

}  // namespace agnocast::test
