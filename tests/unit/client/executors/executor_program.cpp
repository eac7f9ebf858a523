// SPDX-License-Identifier: Apache-2.0
//
// executor_program MODE EXECUTOR: ends in the middle of callbacks, which are those of timers.
//   EXECUTOR: multi, isolated, background
//   exit          a callback calls exit(7), and the executor has static storage
//   fork          main forks while callbacks run; the child destroys the executor and exits with 7
//   fork_inside   a callback forks, and returns in the child; the spin or the process ends there
//   thread_ends   callbacks end their threads (pthread_exit); others still run: exits with 7
// Exits with 7 if all went as it should, 0 where that is said.

#include <agnocast/executor.hpp>
#include <agnocast/timer.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <pthread.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;

const test::PlainNode node;

std::unique_ptr<Executor> make_executor(const std::string& kind) {
  if (kind == "multi") return std::make_unique<MultiThreadedExecutor>(4);
  if (kind == "isolated") return std::make_unique<CallbackIsolatedExecutor>();
  return std::make_unique<BackgroundExecutor>();
}

/// Timers in groups of their own; the first calls `first`.
template <class Callback>
std::vector<WallTimer::SharedPtr> make_timers(std::atomic<int>& calls, Callback first) {
  std::vector<WallTimer::SharedPtr> timers;
  for (int i = 0; i < 6; ++i) {
    const auto group = create_callback_group(node, CallbackGroupType::MutuallyExclusive);
    const auto call = [&calls, first, i] {
      ++calls;
      if (i == 0) first();
    };
    timers.push_back(create_wall_timer(node, 1ms, call, group));
  }
  return timers;
}

int status_of(pid_t child) {
  int status = 0;
  ::waitpid(child, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : 100;
}

/// BackgroundExecutor spins by itself.
void spin(Executor& executor, const std::string& kind) {
  if (kind != "background") return executor.spin();
  for (;;) ::pause();
}

int run(const std::string& mode, const std::string& kind) {
  static std::atomic<int> calls{0};
  static std::unique_ptr<Executor> executor = make_executor(kind);
  executor->add_node(node);
  if (mode == "exit") {
    static const auto timers = make_timers(calls, [] {
      if (calls > 20) std::exit(7);
    });
    spin(*executor, kind);
  }
  if (mode == "fork") {
    static const auto timers = make_timers(calls, [] {});
    std::thread([&] { spin(*executor, kind); }).detach();
    while (calls < 20) ::usleep(1000);
    const pid_t child = ::fork();
    if (child == 0) {
      executor.reset();
      std::exit(7);
    }
    ::_exit(status_of(child));
  }
  if (mode == "fork_inside") {
    static const pid_t self = ::getpid();
    static const auto timers = make_timers(calls, [] {
      if (::getpid() != self || calls < 20) return;
      const pid_t child = ::fork();
      if (child != 0) ::_exit(status_of(child));
    });
    try {
      spin(*executor, kind);
    } catch (const Error& error) {
      std::exit(error.failure().code == Errc::shut_down ? 7 : 1);
    }
  }
  if (mode == "thread_ends") {
    static std::atomic<int> ended{0};
    static std::atomic<std::thread::id> spinner{};
    static const auto timers = make_timers(calls, [] {
      if (ended == 3) ::_exit(7);
      if (std::this_thread::get_id() == spinner.load()) return;  // its end would be that of spin()
      ++ended;
      ::pthread_exit(nullptr);
    });
    std::thread([&] {
      spinner = std::this_thread::get_id();
      spin(*executor, kind);
    }).detach();
    for (;;) ::pause();
  }
  return 1;
}

}  // namespace
}  // namespace agnocast

int main(int argc, char** argv) { return argc == 3 ? agnocast::run(argv[1], argv[2]) : 2; }
