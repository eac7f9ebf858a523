// SPDX-License-Identifier: Apache-2.0
//
// ClientTool: a process of tests/integration/client_tool, steered line by line.
#pragma once

#include <base/unique_fd.hpp>

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

class ClientTool {
 public:
  explicit ClientTool(const std::string& socket_path) {
    int pair[2];
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) std::abort();
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawn_file_actions_adddup2(&actions, pair[1], STDIN_FILENO);
    ::posix_spawn_file_actions_adddup2(&actions, pair[1], STDOUT_FILENO);
    std::string socket = "AGNOCAST_SOCKET=" + socket_path;
    std::vector<char*> environment{socket.data()};
    for (char** variable = environ; *variable != nullptr; ++variable)
      environment.push_back(*variable);
    environment.push_back(nullptr);
    char program[] = AGNOCAST_CLIENT_TOOL;
    char* arguments[] = {program, nullptr};
    if (::posix_spawn(&pid_, program, &actions, nullptr, arguments, environment.data()) != 0)
      std::abort();
    ::posix_spawn_file_actions_destroy(&actions);
    ::close(pair[1]);
    socket_.reset(pair[0]);
  }
  ~ClientTool() { kill(); }
  ClientTool(const ClientTool&) = delete;
  ClientTool& operator=(const ClientTool&) = delete;

  void tell(const std::string& line) {
    const std::string text = line + "\n";
    (void)!::send(socket_.get(), text.data(), text.size(), MSG_NOSIGNAL);
  }
  /// The next line it says; what happened instead when there is none within 20 s.
  std::string answer() {
    std::string line;
    for (;;) {
      pollfd readable{socket_.get(), POLLIN, 0};
      if (::poll(&readable, 1, 20000) <= 0) return "(no answer within 20 s)";
      char letter = 0;
      if (::recv(socket_.get(), &letter, 1, 0) != 1) return "(it has ended)";
      if (letter == '\n') return line;
      line += letter;
    }
  }
  std::string ask(const std::string& line) {
    tell(line);
    return answer();
  }
  /// Asks until the answer is this one; false after 10 s.
  bool eventually(const std::string& line, const std::string& wanted) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(10);
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
  pid_t pid() const { return pid_; }

 private:
  pid_t pid_ = -1;
  UniqueFd socket_;
};

}  // namespace agnocast::test
