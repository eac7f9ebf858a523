// SPDX-License-Identifier: Apache-2.0
//
// Goal: components that use agnocast come and go in a container under traffic, and leave nothing
// behind. Method: the container as a program, its services called by a node of this process, which
// also makes the traffic; descriptors, mappings and memory of the container as /proc has them.
// AGNOCAST_TEST_LOADS sets another number of loads than 100.

#include "test_node.hpp"

#include <composition_interfaces/srv/load_node.hpp>
#include <composition_interfaces/srv/unload_node.hpp>

#include <gmock/gmock.h>

#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <set>
#include <vector>

extern char** environ;

namespace agnocast_rclcpp {
namespace {

using composition_interfaces::srv::LoadNode;
using composition_interfaces::srv::UnloadNode;
using namespace std::chrono_literals;

class Container {
 public:
  explicit Container(const std::string& kind) : name_("container_" + std::to_string(::getpid())) {
    std::vector<std::string> words{CONTAINER,    "--executor", kind,
                                   "--ros-args", "-r",         "__node:=" + name_};
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    if (::posix_spawn(&pid_, CONTAINER, nullptr, nullptr, argv.data(), environ) != 0) std::abort();
  }
  ~Container() {
    ::kill(pid_, SIGINT);
    int status = 0;
    for (int i = 0; i < 3000 && ::waitpid(pid_, &status, WNOHANG) == 0; ++i)
      std::this_thread::sleep_for(10ms);
    if (::kill(pid_, SIGKILL) == 0) {
      ::waitpid(pid_, &status, 0);
      ADD_FAILURE() << "the container does not end by SIGINT";
    }
  }
  Container(const Container&) = delete;
  Container& operator=(const Container&) = delete;

  std::string service(const std::string& verb) const { return name_ + "/_container/" + verb; }
  std::size_t descriptors() const { return entries("fd"); }
  std::size_t threads() const { return entries("task"); }
  std::size_t mappings() const {
    std::ifstream file(path("maps"));
    std::size_t count = 0;
    for (std::string line; std::getline(file, line);) ++count;
    return count;
  }
  /// Memory of its own: its resident pages but for those that it shares.
  std::size_t own_kilobytes() const {
    std::ifstream file(path("smaps_rollup"));
    std::size_t sum = 0;
    for (std::string word; file >> word;) {
      if (word != "Private_Dirty:") continue;
      file >> sum;
    }
    return sum;
  }

 private:
  std::string path(const std::string& file) const {
    return "/proc/" + std::to_string(pid_) + '/' + file;
  }
  std::size_t entries(const std::string& directory) const {
    std::size_t count = 0;
    for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(path(directory)))
      ++count;
    return count;
  }
  std::string name_;
  pid_t pid_ = -1;
};

class ComponentsTest : public RclcppTest, public testing::WithParamInterface<const char*> {
 protected:
  void SetUp() override {
    RclcppTest::SetUp();
    container_ = std::make_unique<Container>(GetParam());
    node_ = std::make_shared<rclcpp::Node>("components_test");
    executor_ = std::make_unique<rclcpp::executors::SingleThreadedExecutor>();
    executor_->add_node(node_);
    load_ = node_->create_client<LoadNode>(container_->service("load_node"));
    unload_ = node_->create_client<UnloadNode>(container_->service("unload_node"));
    publisher_ = agnocast::create_publisher<String>(node_, "/in", 10);
    for (int topic = 0; topic < 10; ++topic) {
      subscriptions_.push_back(agnocast::create_subscription<String>(
          node_, "/out_" + std::to_string(topic), rclcpp::QoS(1000),
          [this](const agnocast::ipc_shared_ptr<const String>& message,
                 const agnocast::MessageInfo& info) {
            if (message->data == wanted_) answered_.insert(info.publisher);
          }));
    }
    ASSERT_TRUE(load_->wait_for_service(30s) && unload_->wait_for_service(30s));
  }
  void TearDown() override {
    subscriptions_.clear();
    publisher_.reset();
    load_.reset();
    unload_.reset();
    executor_.reset();
    node_.reset();
    container_.reset();
    RclcppTest::TearDown();
  }

  template <class Service, class Request>
  auto call(rclcpp::Client<Service>& client, const Request& request) {
    auto answer = client.async_send_request(request).future.share();
    EXPECT_EQ(executor_->spin_until_future_complete(answer, 60s),
              rclcpp::FutureReturnCode::SUCCESS);
    return answer.get();
  }
  /// Returns the number by which the container knows the component.
  std::uint64_t load(const std::string& name) {
    auto request = std::make_shared<LoadNode::Request>();
    request->package_name = "agnocast_rclcpp_test_components";
    request->plugin_name = "agnocast_rclcpp::Relay";
    request->node_name = name;
    const auto answer = call(*load_, request);
    EXPECT_TRUE(answer->success) << answer->error_message;
    return answer->unique_id;
  }
  void unload(std::uint64_t id) {
    auto request = std::make_shared<UnloadNode::Request>();
    request->unique_id = id;
    const auto answer = call(*unload_, request);
    EXPECT_TRUE(answer->success) << answer->error_message;
  }
  /// Publishes until this many components have answered one message.
  [[nodiscard]] bool all_answer(std::size_t count) {
    for (int i = 0; i < 600; ++i) {
      wanted_ = "message " + std::to_string(++number_);
      answered_.clear();
      String message;
      message.data = wanted_;
      (void)publisher_->publish(message);
      // One callback each.
      for (std::size_t k = 0; k < 2 * count + 100 && answered_.size() < count; ++k)
        executor_->spin_once(1ms);
      if (answered_.size() == count) return true;
    }
    return false;
  }

  std::unique_ptr<Container> container_;
  rclcpp::Node::SharedPtr node_;
  std::unique_ptr<rclcpp::executors::SingleThreadedExecutor> executor_;
  rclcpp::Client<LoadNode>::SharedPtr load_;
  rclcpp::Client<UnloadNode>::SharedPtr unload_;
  agnocast::Publisher<String>::SharedPtr publisher_;
  std::vector<agnocast::Subscription<String>::SharedPtr> subscriptions_;
  std::string wanted_;
  std::set<std::uint64_t> answered_;
  std::uint64_t number_ = 0;
};

TEST_P(ComponentsTest, LoadsAndUnloadsLeaveNothingBehind) {
  const char* const text = std::getenv("AGNOCAST_TEST_LOADS");
  const int loads = text != nullptr ? std::atoi(text) : 100;
  const std::uint64_t stays = load("stays");
  struct Figures {
    std::size_t descriptors, threads, mappings, kilobytes;
  };
  const auto look = [&] {
    return Figures{container_->descriptors(), container_->threads(), container_->mappings(),
                   container_->own_kilobytes()};
  };
  const auto cycle = [&](int i) {
    const std::uint64_t id = load("relay_" + std::to_string(i));
    ASSERT_TRUE(all_answer(2)) << i;
    unload(id);
  };
  // What is made once and kept: threads, pools, the first pages of the heap.
  for (int i = 0; i < 20; ++i) cycle(i);
  const Figures before = look();
  for (int i = 20; i < 20 + loads; ++i) cycle(i);
  ASSERT_TRUE(all_answer(1));
  // Unloading ends after its answer.
  Figures after = look();
  const auto is_settled = [&] {
    return after.descriptors <= before.descriptors && after.threads <= before.threads;
  };
  for (int i = 0; i < 3000 && !is_settled(); ++i) {
    std::this_thread::sleep_for(10ms);
    after = look();
  }
  std::cout << loads << " loads in the container '" << GetParam() << "': descriptors "
            << before.descriptors << " to " << after.descriptors << ", threads " << before.threads
            << " to " << after.threads << ", mappings " << before.mappings << " to "
            << after.mappings << ", own memory " << before.kilobytes << " to " << after.kilobytes
            << " KiB\n";
  EXPECT_LE(after.descriptors, before.descriptors);
  EXPECT_LE(after.threads, before.threads);
  // A component has two endpoints, which would be two mappings and a descriptor each.
  EXPECT_LE(after.mappings, before.mappings + static_cast<std::size_t>(loads) / 2);
  // What the allocator keeps, and the first use of heap pages; the nodes of rclcpp are far larger.
  EXPECT_LT(after.kilobytes, before.kilobytes + 4096 + 64 * static_cast<std::size_t>(loads));
  unload(stays);
}

TEST_P(ComponentsTest, TwoHundredNodesFitInOneContainer) {
  std::vector<std::uint64_t> ids{load("stays")};
  std::vector<std::size_t> descriptors;
  for (int round = 0; round < 2; ++round) {
    while (ids.size() < 200) ids.push_back(load("relay_" + std::to_string(ids.size())));
    EXPECT_TRUE(all_answer(200));
    EXPECT_EQ(publisher_->get_subscription_count(), 200u);
    while (ids.size() > 1) {
      unload(ids.back());
      ids.pop_back();
    }
    EXPECT_TRUE(eventually([&] { return publisher_->get_subscription_count() == 1; }));
    EXPECT_TRUE(all_answer(1));
    // The process keeps its wait sets, up to a limit, for the next groups.
    EXPECT_TRUE(eventually(
        [&] { return descriptors.empty() || container_->descriptors() <= descriptors[0]; }));
    descriptors.push_back(container_->descriptors());
  }
  std::cout << "descriptors after 200 nodes in the container '" << GetParam()
            << "': " << descriptors[0] << ", after 200 more: " << descriptors[1] << '\n';
  EXPECT_LE(descriptors[1], descriptors[0]);
  unload(ids[0]);
}

INSTANTIATE_TEST_SUITE_P(Containers, ComponentsTest, testing::Values("single", "multi", "isolated"),
                         [](const auto& info) { return std::string(info.param); });

}  // namespace
}  // namespace agnocast_rclcpp
