// SPDX-License-Identifier: Apache-2.0
//
// Goal: what processes say of their threads gives them no more than the rules do: no thread of
// another process is scheduled, a user's groups and threads are bounded, and the connection's end
// frees them.
// Method: raw clients that say what they like.

#include <tests/integration/daemon/raw_node.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/wire/wire_dump.hpp>

#include <gtest/gtest.h>

#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <thread>

namespace agnocast::test {
namespace {

using wire::Opcode;
using wire::ThreadSetting;

constexpr const char* nice_for_all =
    "[daemon]\nsocket_mode = \"0666\"\n[heap]\nwindow_bytes = \"64MiB\"\narena_bytes = \"1GiB\"\n"
    "[[thread]]\nnode = \"/node\"\nusers = [\"*\"]\nnice = 5\n";

class Client : public WireClient {
 public:
  explicit Client(const DaemonProcess& daemon) : WireClient(daemon.socket_path()) {
    EXPECT_EQ(hello().opcode(), Opcode::welcome);
  }
  void say_group(std::uint64_t executor, std::uint64_t group, bool is_there = true) {
    wire::CallbackGroup body{};
    body.executor = executor;
    body.group = group;
    body.is_there = is_there ? 1 : 0;
    std::strcpy(body.node.text, "/node");
    send(Opcode::callback_group, body);
  }
  void say_thread(std::uint64_t executor, std::uint32_t thread, bool is_there = true) {
    wire::CallbackThread body{};
    body.executor = executor;
    body.thread = thread;
    body.is_there = is_there ? 1 : 0;
    send(Opcode::callback_thread, body);
  }
};

std::uint32_t this_thread() { return static_cast<std::uint32_t>(::syscall(SYS_gettid)); }
int nice_of(std::uint32_t thread) { return ::getpriority(PRIO_PROCESS, thread); }

TEST(DaemonThreads, SchedulesAThreadOfTheProcessThatNamesIt) {
  DaemonProcess daemon({.config = nice_for_all});
  Client client(daemon);
  client.say_group(1, 10);
  client.say_thread(1, this_thread());
  ASSERT_TRUE(eventually([&] {
    const auto threads = wire_dump(daemon.socket_path()).threads;
    return threads.size() == 1 && threads[0].setting == ThreadSetting::applied;
  }));
  EXPECT_EQ(nice_of(this_thread()), 5);
  ::setpriority(PRIO_PROCESS, this_thread(), 0);
}

TEST(DaemonThreads, SchedulesNoThreadOfAnotherProcess) {
  DaemonProcess daemon({.config = nice_for_all});
  const auto victim = static_cast<std::uint32_t>(daemon.supervisor_pid());
  const int before = nice_of(victim);
  Client client(daemon);
  client.say_group(1, 10);
  client.say_thread(1, victim);
  ASSERT_TRUE(eventually([&] {
    const auto threads = wire_dump(daemon.socket_path()).threads;
    return threads.size() == 1 && threads[0].setting == ThreadSetting::not_found;
  }));
  EXPECT_EQ(nice_of(victim), before);
}

TEST(DaemonThreads, CountsGroupsAndThreadsOfAUserUntilTheConnectionEnds) {
  DaemonProcess daemon({.config = nice_for_all,
                        .more_config = "[quota]\ncallback_groups = 3\ncallback_threads = 2\n"});
  auto first = std::make_unique<Client>(daemon);
  Client second(daemon);
  for (std::uint64_t group = 1; group <= 2; ++group) first->say_group(1, group);
  first->say_thread(1, 1000);
  // Two connections have no order between them.
  const auto known = [&] { return wire_dump(daemon.socket_path()); };
  ASSERT_TRUE(
      eventually([&] { return known().groups.size() == 2 && known().threads.size() == 1; }));
  for (std::uint64_t group = 1; group <= 2; ++group) second.say_group(1, group);
  for (std::uint32_t thread = 1000; thread <= 1002; ++thread) second.say_thread(1, thread);
  ASSERT_TRUE(
      eventually([&] { return known().groups.size() == 3 && known().threads.size() == 2; }));
  std::uint64_t left_out = 0;
  for (const auto& process : known().processes) left_out += process.threads_left_out;
  EXPECT_EQ(left_out, 3u);
  ASSERT_EQ(known().users.size(), 1u);
  EXPECT_EQ(known().users[0].use.callback_groups, 3u);
  EXPECT_EQ(known().users[0].use.callback_threads, 2u);
  first->socket() = {};
  EXPECT_TRUE(
      eventually([&] { return known().groups.size() == 1 && known().threads.size() == 1; }));
  second.say_group(2, 20);
  EXPECT_TRUE(eventually([&] { return known().groups.size() == 2; }));
  EXPECT_EQ(known().users[0].use.callback_groups, 2u);
}

// As a process of rclcpp with many groups, whose threads have run each of them.
TEST(DaemonThreads, KnowsAThreadOfManyExecutorsOnce) {
  DaemonProcess daemon({.config = nice_for_all});
  Client client(daemon);
  constexpr std::uint32_t executors = 100, threads = 16;
  for (std::uint32_t executor = 1; executor <= executors; ++executor) {
    client.say_group(executor, 1000 + executor);
    for (std::uint32_t thread = 1; thread <= threads; ++thread)
      client.say_thread(executor, 4'000'000 + thread);
  }
  ASSERT_TRUE(eventually([&] {
    const auto all = wire_dump(daemon.socket_path());
    return all.threads.size() == threads && all.threads.back().executor_count == executors;
  }));
  EXPECT_EQ(wire_dump(daemon.socket_path()).processes[0].threads_left_out, 0u);
}

TEST(DaemonThreads, ServesOthersWhileAProcessChangesItsGroupsWithoutEnd) {
  DaemonProcess daemon({.config = nice_for_all});
  Client client(daemon);
  for (std::uint32_t thread = 1; thread <= abi::callback_thread_count_max + 10; ++thread)
    client.say_thread(1, 4'000'000 + thread);
  std::atomic<bool> is_over{false};
  std::thread changing([&] {
    while (!is_over) {
      client.say_group(1, 10);
      client.say_group(1, 10, false);
    }
    client.say_group(1, 10);
  });
  for (int i = 0; i < 20; ++i) {
    Client other(daemon);
    EXPECT_EQ(other.create_publisher("/a").opcode(), Opcode::endpoint_created);
  }
  is_over = true;
  changing.join();
  EXPECT_TRUE(eventually([&] {
    const auto all = wire_dump(daemon.socket_path());
    return all.threads.size() == abi::callback_thread_count_max && all.groups.size() == 1 &&
           std::all_of(all.threads.begin(), all.threads.end(), [](const auto& thread) {
             return thread.setting == ThreadSetting::not_found;
           });
  }));
}

}  // namespace
}  // namespace agnocast::test
