// SPDX-License-Identifier: Apache-2.0
//
// Goal: of several bridges of one domain at one daemon one has routes, whatever their order, and
// another one takes over when it dies. Method: real bridges with status sockets of their own,
// killed; numbered messages both ways.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <agnocast/agnocast.hpp>
#include <agnocast/graph.hpp>

#include <std_msgs/msg/string.hpp>

#include <algorithm>
#include <cstdlib>
#include <set>
#include <thread>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;
using std_msgs::msg::String;

class Standby : public BridgeTest {
 protected:
  void SetUp() override {}  // each test begins with none
  static std::string status_path(int number) {
    return daemon->directory() + "/status-" + std::to_string(number) + ".sock";
  }
  std::unique_ptr<SteeredProcess> bridge(int number) {
    return make_bridge({"--status-socket", status_path(number)});
  }
  /// Starts the first one, which every later one then knows: its status may come before its marker.
  std::unique_ptr<SteeredProcess> first_bridge() {
    auto first = bridge(1);
    EXPECT_TRUE(other_.eventually([&] {
      const auto seen = Graph().wait(1s);
      return seen && *seen &&
             std::any_of((*seen)->endpoints.begin(), (*seen)->endpoints.end(),
                         [&](const auto& one) {
                           return one.topic == "/_agnocast_bridge" &&
                                  static_cast<pid_t>(one.pid) == first->pid();
                         });
    }));
    return first;
  }
  bool is_standby(int number) {
    const std::string status = status_at(status_path(number));
    return status.find("\"standby_for\":") != std::string::npos &&
           status.find("\"standby_for\":null") == std::string::npos;
  }
  bool is_active(int number) {
    const std::string status = status_at(status_path(number));
    return status.find("\"standby_for\":null") != std::string::npos &&
           status.find("\"dds_writers\":[]") == std::string::npos;
  }
};

/// Numbered messages both ways, each of which may arrive once.
class Flow {
 public:
  Flow(Other& other, const std::string& topic) : other_(other) {
    DdsQos qos;
    qos.depth = 1000;
    publisher_ = create_publisher<String>(PlainNode(), topic + "_out", 1000);
    reader_ = &other.reads<String>("rt" + topic + "_out", qos);
    subscription_ = create_subscription<String>(PlainNode(), topic + "_in", 1000);
    writer_ = &other.writes("rt" + topic + "_in", dds_type_name<String>(), qos);
  }
  void send() {
    const std::string number = std::to_string(++sent_);
    auto loan = publisher_->borrow_loaned_message();
    loan->data = number;
    EXPECT_TRUE(publisher_->publish(std::move(loan)));
    String message;
    message.data = number;
    EXPECT_TRUE(Other::write(*writer_, message, sent_));
  }
  void take() {
    while (const auto sample = reader_->take()) {
      if (sample->state != DdsSample::State::valid) continue;
      const auto& data = static_cast<String*>(sample->object.get())->data;
      EXPECT_TRUE(out_.insert(std::stoi(data)).second) << data << " was written twice";
    }
    while (const auto message = subscription_->take()) {
      EXPECT_TRUE(in_.insert(std::stoi(message->data)).second) << message->data << " came twice";
    }
  }
  /// Returns whether messages sent from now on arrive, both ways.
  bool flows() {
    const int before = sent_;
    return other_.eventually([&] {
      send();
      other_.look(10ms);
      take();
      return !out_.empty() && *out_.rbegin() > before && !in_.empty() && *in_.rbegin() > before;
    });
  }
  /// Expects all of these, and no further message.
  void expect_each_once() {
    const int before = sent_;
    for (int i = 0; i < 100; ++i) send();
    EXPECT_TRUE(other_.eventually([&] {
      take();
      return has_all_since(out_, before) && has_all_since(in_, before);
    }));
    for (int i = 0; i < 20; ++i) {
      other_.look(10ms);
      take();
    }
  }

 private:
  bool has_all_since(const std::set<int>& numbers, int before) const {
    return std::distance(numbers.upper_bound(before), numbers.end()) == sent_ - before;
  }

  Other& other_;
  Publisher<String>::SharedPtr publisher_;
  Subscription<String>::SharedPtr subscription_;
  DdsReader* reader_ = nullptr;
  DdsWriter* writer_ = nullptr;
  int sent_ = 0;
  std::set<int> out_, in_;
};

TEST_F(Standby, HasNoRouteAndTakesOverFromAKilledBridge) {
  auto first = first_bridge();
  // No topic exists yet.
  auto second = bridge(2);
  ASSERT_TRUE(other_.eventually([&] { return is_standby(2); }));
  EXPECT_EQ(said("another bridge serves this domain"), 1u);
  Flow flow(other_, topic());
  ASSERT_TRUE(flow.flows());
  flow.expect_each_once();
  EXPECT_TRUE(is_active(1));
  EXPECT_TRUE(is_standby(2));

  for (int killed = 1; killed <= 3; ++killed) {
    first = std::move(second);  // SIGKILL
    second = bridge(killed + 2);
    ASSERT_TRUE(other_.eventually([&] { return is_active(killed + 1); }));
    ASSERT_TRUE(other_.eventually([&] { return is_standby(killed + 2); }));
    ASSERT_TRUE(flow.flows()) << "no bridge has taken over";
    flow.expect_each_once();
  }
  EXPECT_EQ(said("the other bridge of this domain has ended"), 3u);
}

TEST_F(Standby, TakesOverFromARevokedBridgeWhichExits) {
  auto first = first_bridge();
  auto second = bridge(2);
  ASSERT_TRUE(other_.eventually([&] { return is_standby(2); }));
  Flow flow(other_, topic());
  ASSERT_TRUE(flow.flows());
  const std::string revoke = std::string(AGNOCAST_TEST_CTL) + " --socket " + daemon->socket_path() +
                             " process revoke " + std::to_string(first->pid());
  ASSERT_EQ(std::system(revoke.c_str()), 0) << revoke;
  ASSERT_TRUE(other_.eventually([&] { return is_active(2); }));
  ASSERT_TRUE(flow.flows()) << "no bridge has taken over";
  EXPECT_EQ(first->finish(), 1) << "the status after which its unit restarts it";
}

TEST_F(Standby, IsTheStateOfAllButOneOfSimultaneousBridges) {
  std::vector<std::unique_ptr<SteeredProcess>> bridges;
  Flow flow(other_, topic());
  for (int i = 1; i <= 3; ++i) bridges.push_back(bridge(i));
  ASSERT_TRUE(flow.flows());
  ASSERT_TRUE(other_.eventually([&] {
    return is_standby(1) + is_standby(2) + is_standby(3) == 2 &&
           is_active(1) + is_active(2) + is_active(3) == 1;
  }));
  flow.expect_each_once();
}

TEST_F(Standby, IsNotTheStateOfABridgeOfAnotherDomain) {
  auto first = bridge(1);
  Flow flow(other_, topic());
  ASSERT_TRUE(flow.flows());
  const Domain another;
  auto second =
      make_bridge({"--status-socket", status_path(2), "--domain", std::to_string(another.id())});
  ASSERT_TRUE(other_.eventually(
      [&] { return status_at(status_path(2)).find("\"standby_for\":null") != std::string::npos; }));
  flow.expect_each_once();
  EXPECT_FALSE(is_standby(2));
}

}  // namespace
}  // namespace agnocast::test
