// SPDX-License-Identifier: Apache-2.0
//
// Goal: the death of a process that had as much as it could get delays no other process, and all
// its resources come back.
// Method: an attacker of another user fills its memory, or subscribes a few thousand times to
// topics with many publishers; it is killed, and the honest pair continues and makes requests
// until nothing of the attacker is left. The attack table (largest gap) has the honest pair's
// waiting times: they depend on the machine, so no test judges them.

#include <base/memory/memfd.hpp>
#include <base/memory/populate.hpp>
#include <tests/hostile/hostile_node.hpp>
#include <tests/support/processes/ctl.hpp>

#include <fcntl.h>
#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <initializer_list>
#include <memory>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::test {
namespace {

using wire::Kind;
using wire::Opcode;

void pause_briefly() { std::this_thread::sleep_for(std::chrono::milliseconds(5)); }

std::uint64_t inode_of(int fd) {
  struct stat file {};
  return ::fstat(fd, &file) == 0 ? file.st_ino : 0;
}

/// Returns whether this process maps a memfd with this inode or has a descriptor of one.
bool has_memory(pid_t pid, std::uint64_t inode) {
  const std::string process = "/proc/" + std::to_string(pid);
  std::ifstream maps(process + "/maps");
  for (std::string line; std::getline(maps, line);) {
    // address rights offset device inode path
    std::istringstream words(line);
    std::string ignored, path;
    std::uint64_t mapped = 0;
    words >> ignored >> ignored >> ignored >> ignored >> mapped >> path;
    if (mapped == inode && path.rfind("/memfd:", 0) == 0) return true;
  }
  std::error_code none;
  for (const auto& entry : std::filesystem::directory_iterator(process + "/fd", none)) {
    struct stat file {};
    const std::string target = std::filesystem::read_symlink(entry.path(), none).string();
    if (target.rfind("/memfd:", 0) == 0 && ::stat(entry.path().c_str(), &file) == 0 &&
        file.st_ino == inode)
      return true;
  }
  return false;
}

/// Returns whether a process on the stage keeps that memory. The kernel frees it when no process
/// has a descriptor or a mapping.
bool is_kept(Stage& stage, std::uint64_t inode) {
  const std::initializer_list<pid_t> processes = {
      stage.daemon().pid(), stage.daemon().supervisor_pid(), stage.publisher().pid(),
      stage.subscriber().pid()};
  return std::any_of(processes.begin(), processes.end(),
                     [&](pid_t pid) { return has_memory(pid, inode); });
}

/// A sixteenth of the machine's memory, at most half a gibibyte: the test fills twice as much.
std::uint64_t filled_bytes() {
  const auto pages = static_cast<std::uint64_t>(::sysconf(_SC_PHYS_PAGES));
  const std::uint64_t share = pages * abi::page_bytes / 16;
  return std::min<std::uint64_t>(share, std::uint64_t{512} << 20) / abi::page_bytes *
         abi::page_bytes;
}

void fill(int fd, std::uint64_t bytes) {
  EXPECT_EQ(::fallocate(fd, 0, 0, static_cast<off_t>(bytes)), 0) << "errno " << errno;
}

TEST(HostileEndings, MemoryFilledByADeadProcessIsFreedWhileOthersGoOn) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage;
  const pid_t daemon = stage.daemon().pid();
  for (int life = 0; life < 2; ++life) {
    SCOPED_TRACE("life " + std::to_string(life));
    // Inodes: of the region first, then of each window.
    Attacker attacker([&](Attack& attack) {
      HostileNode node(stage.socket_path());
      // The daemon announces all its memory to the subscriber of this topic.
      node.join(Kind::publisher, open_topic);
      const std::uint64_t in_region = std::min(filled_bytes(), node.welcome().client_region_bytes);
      EXPECT_TRUE(lengthen(node.region_fd(), in_region));  // it may be immutable
      EXPECT_TRUE(populate(node.region(), in_region));
      attack.word(0) = inode_of(node.region_fd());
      std::vector<Incoming> windows;
      std::uint64_t left = filled_bytes();
      for (std::uint64_t i = 0; i < abi::window_count_max && left > 0; ++i) {
        int fd = node.window_fd();
        if (i > 0) {
          windows.push_back(node.wire().open_window(i));
          ASSERT_EQ(windows.back().opcode(), Opcode::window_opened)
              << windows.back().refused_text();
          fd = windows.back().fds[0].get();
        }
        const std::uint64_t bytes = std::min(left, node.open_window().bytes);
        fill(fd, bytes);
        left -= bytes;
        attack.word(i + 1) = inode_of(fd);
      }
      attack.ready();
      while (attack.goes_on()) pause_briefly();
    });
    ASSERT_TRUE(attacker.wait_until_ready());
    const auto is_somewhere = [&] {
      for (std::size_t i = 0; i <= abi::window_count_max; ++i) {
        if (attacker.word(i) != 0 && is_kept(stage, attacker.word(i))) return true;
      }
      return false;
    };
    EXPECT_TRUE(is_somewhere()) << "the daemon has no memory of the attacker to free";
    attacker.kill();
    EXPECT_TRUE(eventually([&] {
      stage.honest_is_served();
      return testing::Test::HasFailure() || !is_somewhere();
    })) << "a process keeps memory of a dead process";
    stage.honest_goes_on();
    stage.honest_is_served();
  }
  EXPECT_EQ(stage.daemon().pid(), daemon) << stage.daemon().log();
}

constexpr std::uint64_t topic_count = 6;
constexpr std::uint64_t subscriptions_per_topic = 500;  // less than one user's share
// The daemon announces each publisher of a topic to each subscription, and the other way round:
// the time that the test takes grows with the product.
constexpr std::uint64_t publisher_process_count = 2;
constexpr std::uint64_t publishers_per_topic_and_process = 20;

std::string crowded(std::uint64_t topic) { return "/crowded" + std::to_string(topic); }

/// Drops the packets received so far, with their descriptors.
void forget_what_came(WireClient& wire) {
  while (wire.poll()) {
  }
}

/// Many publishers in a few processes that read every packet and send nothing.
void publish_in_masses(const std::string& path, Attack& attack) {
  std::vector<std::unique_ptr<HostileNode>> nodes;
  for (std::uint64_t process = 0; process < publisher_process_count; ++process) {
    nodes.push_back(std::make_unique<HostileNode>(path));
    for (std::uint64_t topic = 0; topic < topic_count; ++topic) {
      for (std::uint64_t i = 0; i < publishers_per_topic_and_process; ++i) {
        const Incoming made = nodes.back()->wire().create_publisher(crowded(topic));
        ASSERT_EQ(made.opcode(), Opcode::endpoint_created) << made.refused_text();
      }
    }
  }
  attack.ready();
  while (attack.goes_on()) {
    for (const auto& node : nodes) forget_what_came(node->wire());
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

void subscribe_in_masses(const std::string& path, Attack& attack) {
  HostileNode node(path);
  node.open_wait_set();
  // So many requests are under way at once; sent one by one, each would wait for a time slice of
  // both processes.
  constexpr std::uint64_t row = 50;
  static_assert(subscriptions_per_topic % row == 0);
  for (std::uint64_t topic = 0; topic < topic_count; ++topic) {
    auto body = WireClient::endpoint(crowded(topic), {});
    body.quota = 1;  // any process may hold that many of others
    for (std::uint64_t made = 0; made < subscriptions_per_topic;) {
      for (std::uint64_t i = 0; i < row; ++i) node.wire().send(Opcode::create_subscription, body);
      for (const std::uint64_t end = made + row; made < end;) {
        const Incoming packet = node.wire().next();
        ASSERT_FALSE(packet.bytes.empty());
        ASSERT_NE(packet.opcode(), Opcode::refused) << packet.refused_text();
        if (packet.opcode() == Opcode::endpoint_created) ++made;
      }
    }
  }
  attack.ready();
  while (attack.goes_on()) pause_briefly();
}

TEST(HostileEndings, ThousandsOfSubscriptionsThatDieAtOnceDelayNobody) {
  AGNOCAST_NEEDS_TWO_USERS();
  Stage stage({.quota = ""});
  const pid_t daemon = stage.daemon().pid();
  const auto in_use = [&] {
    return run_ctl(stage.socket_path(), {"status", "-j"}).json()["in_use"];
  };
  const auto before = in_use();
  {
    Attacker publishers([&](Attack& attack) { publish_in_masses(stage.socket_path(), attack); },
                        third_uid);
    ASSERT_TRUE(publishers.wait_until_ready());
    const auto without = in_use();
    Attacker attacker([&](Attack& attack) { subscribe_in_masses(stage.socket_path(), attack); });
    ASSERT_TRUE(attacker.wait_until_ready());
    EXPECT_EQ(
        in_use()["subscriptions"].get<std::uint64_t>(),
        without["subscriptions"].get<std::uint64_t>() + topic_count * subscriptions_per_topic);
    stage.honest_goes_on();
    attacker.kill();
    // The daemon gets the first of these requests during the cleanup.
    for (int i = 0; i < 20; ++i) stage.honest_is_served();
    stage.honest_goes_on();
    publishers.kill();
  }
  // Silent publishers acknowledge nothing; the last resources go with their death.
  EXPECT_TRUE(eventually([&] {
    stage.honest_is_served();
    return testing::Test::HasFailure() || in_use() == before;
  })) << in_use()
      << " and before " << before;
  EXPECT_EQ(stage.daemon().pid(), daemon) << stage.daemon().log();
  EXPECT_EQ(run_ctl(stage.socket_path(), {"verify"}).status, 0);
}

}  // namespace
}  // namespace agnocast::test
