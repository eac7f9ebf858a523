// SPDX-License-Identifier: Apache-2.0
//
// Goal: components that use agnocast come and go in a container under traffic, and leave no more
// behind than components of rclcpp alone. Method: the container as a program, its services called
// by a node of this process; a thread publishes what the components hear all the while;
// descriptors, mappings and memory of the container as /proc has them. AGNOCAST_TEST_LOADS sets
// another number of loads than 100.

#include "test_node.hpp"

#include <composition_interfaces/srv/load_node.hpp>
#include <composition_interfaces/srv/unload_node.hpp>

#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <ostream>
#include <set>
#include <thread>
#include <vector>

extern char** environ;

namespace agnocast_rclcpp {
namespace {

using composition_interfaces::srv::LoadNode;
using composition_interfaces::srv::UnloadNode;
using namespace std::chrono_literals;

/// What a process has. Memory of its own: its resident pages but for those that it shares.
struct Figures {
  std::size_t descriptors, threads, mappings, kilobytes;
};
std::ostream& operator<<(std::ostream& out, const Figures& figures) {
  return out << figures.descriptors << " descriptors, " << figures.threads << " threads, "
             << figures.mappings << " mappings, " << figures.kilobytes << " KiB of its own";
}

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
  Figures figures() const { return {entries("fd"), entries("task"), mappings(), own_kilobytes()}; }
  /// The figures when ended components are gone: unloading ends after its answer.
  Figures settled_figures(const Figures& before) const {
    Figures now = figures();
    for (int i = 0;
         i < 3000 && (now.descriptors > before.descriptors || now.threads > before.threads); ++i) {
      std::this_thread::sleep_for(10ms);
      now = figures();
    }
    return now;
  }

 private:
  std::size_t mappings() const {
    std::ifstream file(path("maps"));
    std::size_t count = 0;
    for (std::string line; std::getline(file, line);) ++count;
    return count;
  }
  std::size_t own_kilobytes() const {
    std::ifstream file(path("smaps_rollup"));
    std::size_t sum = 0;
    for (std::string word; file >> word;) {
      if (word != "Private_Dirty:") continue;
      file >> sum;
    }
    return sum;
  }
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
  std::uint64_t load(const std::string& name, const std::string& component = "Relay") {
    auto request = std::make_shared<LoadNode::Request>();
    request->package_name = "agnocast_rclcpp_test_components";
    request->plugin_name = "agnocast_rclcpp::" + component;
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

/// Publishes on "/in" while it exists.
class Traffic {
 public:
  explicit Traffic(const rclcpp::Node::SharedPtr& node)
      : publisher_(agnocast::create_publisher<String>(node, "/in", 10)), thread_([this] {
          String message;
          message.data = "traffic";
          for (; !is_over_; std::this_thread::sleep_for(1ms)) {
            (void)publisher_->publish(message);
            ++published_;
          }
        }) {}
  ~Traffic() {
    is_over_ = true;
    thread_.join();
  }
  std::uint64_t published() const { return published_; }

 private:
  agnocast::Publisher<String>::SharedPtr publisher_;
  std::atomic<bool> is_over_{false};
  std::atomic<std::uint64_t> published_{0};
  std::thread thread_;
};

TEST_P(ComponentsTest, LoadsAndUnloadsLeaveNothingBehind) {
  const char* const text = std::getenv("AGNOCAST_TEST_LOADS");
  const int loads = text != nullptr ? std::atoi(text) : 100;
  const std::uint64_t stays = load("stays");
  const auto cycle = [&](const char* component, int count) {
    for (int i = 0; i < count; ++i) {
      const std::uint64_t id = load("relay_" + std::to_string(i), component);
      if (component == std::string("Relay")) {
        ASSERT_TRUE(all_answer(2)) << i;
      }
      unload(id);
    }
    ASSERT_TRUE(all_answer(1));
  };
  Figures before, between, after;
  {
    const Traffic traffic(node_);
    // What is made once and kept: threads, pools, the first pages of the heap.
    for (const char* component : {"PlainRelay", "Relay"}) cycle(component, 20);
    before = container_->figures();
    cycle("PlainRelay", loads);
    between = container_->settled_figures(before);
    const std::uint64_t published = traffic.published();
    cycle("Relay", loads);
    EXPECT_GT(traffic.published(), published + static_cast<std::uint64_t>(loads));
    after = container_->settled_figures(between);
  }
  std::cout << "the container '" << GetParam() << "' before: " << before << "\nafter " << loads
            << " loads of a component of rclcpp alone: " << between
            << "\nafter as many of ours: " << after << '\n';
  // The process may keep one wait set more.
  EXPECT_LE(after.descriptors, between.descriptors + 3);
  EXPECT_LE(after.threads, between.threads);
  // A component has two endpoints, which would be two mappings each.
  EXPECT_LE(after.mappings, between.mappings + static_cast<std::size_t>(loads) / 10);
  const auto growth = [](const Figures& from, const Figures& to) {
    return std::max(from.kilobytes, to.kilobytes) - from.kilobytes;
  };
  // 2 MiB: what an allocator keeps back differs from run to run.
  EXPECT_LE(growth(between, after), growth(before, between) + 2048);
  unload(stays);
}

TEST_P(ComponentsTest, TwoHundredNodesFitInOneContainer) {
  std::vector<std::uint64_t> ids{load("stays")};
  std::vector<Figures> figures;
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
    figures.push_back(figures.empty() ? container_->figures()
                                      : container_->settled_figures(figures[0]));
    std::cout << "after 200 nodes in the container '" << GetParam() << "': " << figures.back()
              << '\n';
  }
  EXPECT_LE(figures[1].descriptors, figures[0].descriptors);
  EXPECT_LE(figures[1].threads, figures[0].threads);
  EXPECT_LE(figures[1].mappings, figures[0].mappings + 20);
  EXPECT_LE(figures[1].kilobytes, figures[0].kilobytes + 16 * 1024);
  // One stays: the container ends with its components.
}

INSTANTIATE_TEST_SUITE_P(Containers, ComponentsTest, testing::Values("single", "multi", "isolated"),
                         [](const auto& info) { return std::string(info.param); });

}  // namespace
}  // namespace agnocast_rclcpp
