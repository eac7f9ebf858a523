// SPDX-License-Identifier: Apache-2.0

#include <agnocast/agnocast.hpp>
#include <tests/integration/client/programs/second_process.hpp>

#include <tests/support/sources_main.hpp>

#include <signal.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <gmock/gmock.h>

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <thread>

namespace agnocast::test {

struct Other {
  double value[3] = {};
};

QoS qos_of(const std::string& text) {
  char* letters = nullptr;
  QoS qos(std::strtoull(text.c_str(), &letters, 10));
  while (*letters != '\0') {
    const char letter = *letters++;
    if (letter == 'b') qos.best_effort();
    if (letter == 't') qos.transient_local();
    if (letter == 'a') qos.keep_all(qos.depth());
    if (letter == 'm') qos.liveliness(Liveliness::manual_by_topic);
    if (letter == 'd') qos.deadline(std::chrono::seconds(std::strtoll(letters, &letters, 10)));
    if (letter == 'l')
      qos.liveliness_lease_duration(std::chrono::seconds(std::strtoll(letters, &letters, 10)));
  }
  return qos;
}

namespace {

void wait_for_end_of_input() {
  char letter = 0;
  while (::read(STDIN_FILENO, &letter, 1) > 0) {
  }
}

int play(const std::vector<std::string>& role) {
  Node node("second");
  const std::string& what = role[0];
  if (what == "publish") {
    auto publisher = node.create_publisher<Number>(role[1], qos_of(role[2]));
    const std::uint64_t count = std::stoull(role[3]);
    while (count != 0 && publisher->get_subscription_count() == 0)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    for (std::uint64_t value = 1; value <= count; ++value) {
      auto number = publisher->borrow_loaned_message();
      number->value = value;
      if (!publisher->publish_for(std::move(number), std::chrono::seconds(60))) return 3;
    }
    wait_for_end_of_input();
  } else if (what == "subscribe") {
    auto subscription = node.create_subscription<Number>(role[1], qos_of(role[2]));
    wait_for_end_of_input();
  } else if (what == "blocks") {
    auto subscription = node.create_subscription<Block>(role[1], qos_of(role[2]));
    wait_for_end_of_input();
    bool is_damaged = false;
    while (const auto block = subscription->take()) is_damaged = is_damaged || !block->is_intact();
    return is_damaged ? 5 : 0;
  } else if (what == "other_type") {
    const auto refused = try_create_subscription<Other>(node, role[1], 1);
    if (refused || refused.error().code != Errc::type_mismatch) return 4;
    wait_for_end_of_input();
  } else {
    return 2;
  }
  return 0;
}

}  // namespace

SecondProcess::SecondProcess(const std::vector<std::string>& role) {
  int pair[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) std::abort();
  posix_spawn_file_actions_t actions;
  ::posix_spawn_file_actions_init(&actions);
  ::posix_spawn_file_actions_adddup2(&actions, pair[1], STDIN_FILENO);
  std::vector<std::string> words{"/proc/self/exe", "--role"};
  words.insert(words.end(), role.begin(), role.end());
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  if (::posix_spawn(&pid_, "/proc/self/exe", &actions, nullptr, arguments.data(), environ) != 0)
    std::abort();
  ::posix_spawn_file_actions_destroy(&actions);
  ::close(pair[1]);
  input_ = pair[0];
}

int SecondProcess::reap() {
  int status = 0;
  while (::waitpid(pid_, &status, 0) < 0 && errno == EINTR) {
  }
  pid_ = -1;
  return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

int SecondProcess::end() {
  ::close(input_);
  input_ = -1;
  return reap();
}

void SecondProcess::kill() {
  if (input_ >= 0) ::close(input_);
  input_ = -1;
  if (pid_ <= 0) return;
  ::kill(pid_, SIGKILL);
  reap();
}

}  // namespace agnocast::test

int main(int argc, char** argv) {
  if (argc > 2 && std::string(argv[1]) == "--role") try {
      return agnocast::test::play({argv + 2, argv + argc});
    } catch (const std::exception& error) {
      std::fprintf(stderr, "second process: %s\n", error.what());
      return 1;
    }
  return agnocast::test::run_tests(argc, argv);
}
