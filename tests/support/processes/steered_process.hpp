// SPDX-License-Identifier: Apache-2.0
//
// SteeredProcess: a program that answers each line on its standard input with one line. The
// destructor kills and reaps it at the latest.
#pragma once

#include <base/descriptors/unique_fd.hpp>

#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::test {

class SteeredProcess {
 public:
  /// `arguments` begin with the path of the program; `variables` ("NAME=value") precede this
  /// process's environment.
  SteeredProcess(std::vector<std::string> arguments, std::vector<std::string> variables) {
    int pair[2];
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) std::abort();
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawn_file_actions_adddup2(&actions, pair[1], STDIN_FILENO);
    ::posix_spawn_file_actions_adddup2(&actions, pair[1], STDOUT_FILENO);
    std::vector<char*> environment, argv;
    for (std::string& variable : variables) environment.push_back(variable.data());
    for (char** variable = environ; *variable != nullptr; ++variable)
      environment.push_back(*variable);
    environment.push_back(nullptr);
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    if (::posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environment.data()) != 0)
      std::abort();
    ::posix_spawn_file_actions_destroy(&actions);
    ::close(pair[1]);
    socket_.reset(pair[0]);
  }
  ~SteeredProcess() { kill(); }
  SteeredProcess(const SteeredProcess&) = delete;
  SteeredProcess& operator=(const SteeredProcess&) = delete;

  void tell(const std::string& line) {
    const std::string text = line + "\n";
    (void)!::send(socket_.get(), text.data(), text.size(), MSG_NOSIGNAL);
  }
  /// Returns the next line of output, or what happened instead if none comes in time.
  std::string answer(int patience_s = 300) {
    for (;;) {
      if (const std::size_t end = said_.find('\n'); end != std::string::npos) {
        std::string line = said_.substr(0, end);
        said_.erase(0, end + 1);
        return line;
      }
      pollfd readable{socket_.get(), POLLIN, 0};
      if (::poll(&readable, 1, patience_s * 1000) <= 0)
        return "(no answer within " + std::to_string(patience_s) + " s)";
      char letters[4096];
      const ssize_t count = ::recv(socket_.get(), letters, sizeof letters, 0);
      if (count <= 0) return "(it has ended)";
      said_.append(letters, static_cast<std::size_t>(count));
    }
  }
  /// Returns whether answer() has a line, or the process ends, within `wait`.
  bool has_answer(std::chrono::milliseconds wait) const {
    if (said_.find('\n') != std::string::npos) return true;
    pollfd readable{socket_.get(), POLLIN, 0};
    return ::poll(&readable, 1, static_cast<int>(wait.count())) > 0;
  }
  std::string ask(const std::string& line, int patience_s = 300) {
    tell(line);
    return answer(patience_s);
  }
  /// Asks until the answer is `wanted`; false after five minutes, which only a test that fails
  /// takes.
  bool eventually(const std::string& line, const std::string& wanted) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(5);
    while (std::chrono::steady_clock::now() < end) {
      if (ask(line) == wanted) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return false;
  }
  void kill() {
    if (pid_ <= 0) return;
    ::kill(pid_, SIGKILL);
    ::waitpid(std::exchange(pid_, -1), nullptr, 0);
  }
  /// Closes its standard input and waits. Returns the exit status, or minus the signal.
  int finish() {
    ::shutdown(socket_.get(), SHUT_WR);
    int status = 0;
    ::waitpid(std::exchange(pid_, -1), &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }
  pid_t pid() const { return pid_; }

 private:
  pid_t pid_ = -1;
  UniqueFd socket_;
  std::string said_;
};

}  // namespace agnocast::test
