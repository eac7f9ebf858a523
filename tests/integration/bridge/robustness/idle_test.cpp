// SPDX-License-Identifier: Apache-2.0
//
// Goal: a bridge with many idle routes sleeps, and has no more threads than one with few. Method:
// the real bridge, and the kernel's count of how often each of its threads went to sleep. Names of
// our threads begin with agnocast; the others are Cyclone DDS's, which keep its leases and wake as
// they like.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <agnocast/agnocast.hpp>

#include <std_msgs/msg/string.hpp>

#include <gmock/gmock.h>

#include <chrono>
#include <cstdio>
#include <filesystem>
#include <map>
#include <thread>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;
using std_msgs::msg::String;

constexpr std::size_t route_count = 50;  // each way
// Few routes, but enough that every lane has some.
constexpr std::size_t few_count = 8;
constexpr auto window = 10s;
// Once a second, and half as often again. A busy machine makes a window longer, and more seconds
// pass in it.
constexpr std::uint64_t sleeps_max = 15;

class Idle : public BridgeTest {
 protected:
  struct Task {
    std::string name;
    std::uint64_t sleeps = 0;
  };
  std::map<std::string, Task> tasks(bool ours) const {
    std::map<std::string, Task> all;
    const std::string directory = "/proc/" + std::to_string(bridge_->pid()) + "/task";
    for (const auto& entry : std::filesystem::directory_iterator(directory)) {
      Task task;
      std::ifstream(entry.path() / "comm") >> task.name;
      std::ifstream status(entry.path() / "status");
      const std::string key = "voluntary_ctxt_switches:";
      for (std::string line; std::getline(status, line);)
        if (line.starts_with(key)) task.sleeps = std::stoull(line.substr(key.size()));
      if (task.name.starts_with("agnocast") == ours) all[entry.path().filename()] = task;
    }
    return all;
  }
  static std::string names(const std::map<std::string, Task>& tasks) {
    std::string text;
    for (const auto& [id, task] : tasks)
      text += task.name + ' ' + std::to_string(task.sleeps) + ", ";
    return text;
  }
  void add_routes(std::size_t count) {
    for (; publishers_.size() < count;) {
      const std::string number = std::to_string(publishers_.size());
      publishers_.push_back(create_publisher<String>(PlainNode(), topic() + "_out" + number, 10));
      subscriptions_.push_back(
          create_subscription<String>(PlainNode(), topic() + "_in" + number, 10));
      readers_.push_back(&other_.reads<String>("rt" + topic() + "_out" + number, DdsQos()));
      writers_.push_back(
          &other_.writes("rt" + topic() + "_in" + number, dds_type_name<String>(), DdsQos()));
    }
    ASSERT_TRUE(other_.eventually([&] {
      for (std::size_t i = 0; i < count; ++i) {
        if (!is_out(*readers_[i], *publishers_[i]) || writers_[i]->matched() != 1 ||
            subscriptions_[i]->get_linked_publisher_count() != 1)
          return false;
      }
      return true;
    }));
  }

  std::vector<Publisher<String>::SharedPtr> publishers_;
  std::vector<Subscription<String>::SharedPtr> subscriptions_;
  std::vector<DdsReader*> readers_;
  std::vector<DdsWriter*> writers_;
};

TEST_F(Idle, ABridgeWithManyIdleRoutesSleepsAndHasNoThreadPerRoute) {
  add_routes(few_count);
  const auto few = tasks(true);
  add_routes(route_count);
  // Threads that created endpoints may still end.
  EXPECT_TRUE(other_.eventually([&] { return tasks(true).size() <= few.size(); }))
      << "with few routes: " << names(few) << "with many: " << names(tasks(true));
  for (const auto& [id, task] : tasks(false))
    EXPECT_THAT(task.name, testing::AnyOf(testing::StartsWith("recv"), testing::StartsWith("dq."),
                                          "tev", "gc", "lease", "fsm", testing::StartsWith("xmit")))
        << "neither ours nor Cyclone's";
  // Discovery may still be running: one interval in which they sleep is enough.
  std::string awake, all;
  for (int attempt = 0; attempt < 6; ++attempt) {
    const auto begin = std::chrono::steady_clock::now();
    const auto before = tasks(true);
    std::this_thread::sleep_for(window);
    awake.clear();
    all.clear();
    const auto after = tasks(true);
    const auto elapsed =
        std::chrono::ceil<std::chrono::seconds>(std::chrono::steady_clock::now() - begin);
    const std::uint64_t most =
        sleeps_max * static_cast<std::uint64_t>(elapsed.count()) / window.count();
    for (const auto& [id, task] : after) {
      const auto was = before.find(id);
      const std::uint64_t sleeps = task.sleeps - (was == before.end() ? 0 : was->second.sleeps);
      all += ' ' + std::to_string(sleeps);
      if (sleeps > most) awake += task.name + ' ' + std::to_string(sleeps) + ", ";
    }
    std::printf("in %d s, each of our threads:%s\n", static_cast<int>(elapsed.count()),
                all.c_str());
    if (awake.empty()) return;
  }
  FAIL() << "in " << window.count()
         << " s or a little more these threads went to sleep too often: " << awake;
}

}  // namespace
}  // namespace agnocast::test
