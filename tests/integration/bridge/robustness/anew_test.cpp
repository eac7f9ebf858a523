// SPDX-License-Identifier: Apache-2.0
//
// Goal: a bridge goes on with another daemon, in which the same numbers mean other publishers.
// Method: topics of two alternating types; the daemon is killed for good and replaced while all
// processes live.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <agnocast/agnocast.hpp>
#include <agnocast/graph.hpp>
#include <bridge/plan/routes.hpp>

#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/string.hpp>

#include <filesystem>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;
using Cloud = sensor_msgs::msg::PointCloud2;
using std_msgs::msg::String;

constexpr std::size_t pairs = 6;

class Anew : public BridgeTest {
 protected:
  static void SetUpTestSuite() {
    domain = std::make_unique<Domain>();
    ::setenv("ROS_DOMAIN_ID", std::to_string(domain->id()).c_str(), 1);
    ::setenv("AGNOCAST_SOCKET", socket().c_str(), 1);
    begin();
  }
  static void TearDownTestSuite() {
    daemon.reset();
    std::filesystem::remove_all(directory());
  }
  static void begin() {
    daemon.reset();
    std::filesystem::create_directories(directory());
    daemon = std::make_unique<DaemonProcess>(DaemonOptions{.socket = socket()});
  }
  static std::string directory() {
    return testing::TempDir() + "bridge_anew-" + std::to_string(::getpid());
  }
  static std::string socket() { return directory() + "/agnocastd.sock"; }
  std::string name(const char* what, std::size_t i) const {
    return topic() + '_' + what + std::to_string(i);
  }
};

TEST_F(Anew, NeverMixesTopics) {
  std::vector<Publisher<String>::SharedPtr> texts;
  std::vector<Publisher<Cloud>::SharedPtr> clouds;
  std::vector<DdsReader*> text_readers, cloud_readers;
  for (std::size_t i = 0; i < pairs; ++i) {
    texts.push_back(create_publisher<String>(PlainNode(), name("text", i), 10));
    clouds.push_back(create_publisher<Cloud>(PlainNode(), name("cloud", i), 10));
    DdsQos qos;
    qos.depth = 100;
    text_readers.push_back(&other_.reads<String>("rt" + name("text", i), qos));
    cloud_readers.push_back(&other_.reads<Cloud>("rt" + name("cloud", i), qos));
  }
  // Every publisher publishes its topic until all readers hear theirs.
  const auto all_flow = [&] {
    std::vector<bool> heard(2 * pairs);
    return other_.eventually([&] {
      for (std::size_t i = 0; i < pairs; ++i) {
        auto text = texts[i]->borrow_loaned_message();
        text->data = name("text", i);
        (void)texts[i]->publish(std::move(text));
        auto cloud = clouds[i]->borrow_loaned_message();
        cloud->header.frame_id = name("cloud", i);
        cloud->data.assign(1'000, static_cast<std::uint8_t>(i));
        (void)clouds[i]->publish(std::move(cloud));
      }
      for (std::size_t i = 0; i < pairs; ++i) {
        while (const auto sample = text_readers[i]->take()) {
          if (sample->state != DdsSample::State::valid) continue;
          heard[2 * i] = true;
          EXPECT_EQ(static_cast<String*>(sample->object.get())->data, name("text", i));
        }
        while (const auto sample = cloud_readers[i]->take()) {
          if (sample->state != DdsSample::State::valid) continue;
          heard[2 * i + 1] = true;
          const auto& cloud = *static_cast<Cloud*>(sample->object.get());
          EXPECT_EQ(cloud.header.frame_id, name("cloud", i));
          EXPECT_EQ(cloud.data.size(), 1'000u);
        }
      }
      return std::find(heard.begin(), heard.end(), false) == heard.end();
    });
  };
  ASSERT_TRUE(all_flow());
  const pid_t bridge = bridge_->pid();
  for (int round = 0; round < 2; ++round) {
    SCOPED_TRACE(round);
    daemon->kill();
    begin();
    // One of them is new, so that the numbers are assigned differently.
    texts[0].reset();
    texts[0] = create_publisher<String>(PlainNode(), name("text", 0), 10);
    // Endpoints that matched before go on without a daemon: so wait until all have joined this
    // one.
    Graph graph;
    ASSERT_TRUE(other_.eventually([&] {
      const auto now = graph.wait(100ms);
      if (!now || !*now) return false;
      std::size_t publishers = 0, local_readers = 0;
      for (const EndpointInfo& endpoint : (*now)->endpoints) {
        if (!endpoint.topic.starts_with(topic())) continue;
        local_readers += bridge::is_bridge(endpoint);
        publishers += !bridge::is_bridge(endpoint);
      }
      return publishers == 2 * pairs && local_readers == 2 * pairs;
    }));
    for (int i = 0; i < 3; ++i) ASSERT_TRUE(all_flow());
    EXPECT_EQ(::kill(bridge, 0), 0) << "the bridge has died";
  }
}

TEST_F(Anew, HandsHistoriesToLateReaders) {
  auto publisher = create_publisher<String>(PlainNode(), topic(), QoS(3).transient_local());
  for (const char* const data : {"1", "2", "3"}) {
    auto loan = publisher->borrow_loaned_message();
    loan->data = data;
    ASSERT_TRUE(publisher->publish(std::move(loan)));
  }
  DdsQos qos;
  qos.depth = 10;
  qos.transient_local = true;
  const auto has_history = [&](DdsReader& reader) {
    for (const char* const data : {"1", "2", "3"}) {
      const auto got = other_.take<String>(reader);
      ASSERT_NE(got, nullptr) << data << " is lost";
      EXPECT_EQ(got->data, data);
    }
  };
  DdsReader& early = other_.reads<String>("rt" + topic(), qos);
  has_history(early);
  const Guid former = other_.last().writer;
  // The publisher has rejoined before the bridge looks.
  ASSERT_EQ(::kill(bridge_->pid(), SIGSTOP), 0);
  daemon->kill();
  begin();
  Graph graph;
  EXPECT_TRUE(other_.eventually([&] {
    const auto now = graph.wait(100ms);
    return now && *now &&
           std::any_of((*now)->endpoints.begin(), (*now)->endpoints.end(),
                       [&](const EndpointInfo& endpoint) { return endpoint.topic == topic(); });
  }));
  ASSERT_EQ(::kill(bridge_->pid(), SIGCONT), 0);
  ASSERT_TRUE(other_.eventually([&] {
    return !other_.participant().remotes().contains(former) && is_out(early, *publisher);
  }));
  has_history(other_.reads<String>("rt" + topic(), qos));
}

TEST_F(Anew, ReportsAtOnceThatTheDaemonIsGoneAndThatItIsBack) {
  const std::string status_path = directory() + "/status.sock";
  bridge_.reset();
  start_bridge({"--status-socket", status_path});
  const auto has_daemon = [&](const char* yes_or_no) {
    return other_.eventually([&] {
      return status_at(status_path).find(std::string("\"has_daemon\":") + yes_or_no) !=
             std::string::npos;
    });
  };
  ASSERT_TRUE(has_daemon("true"));
  EXPECT_EQ(said("agnocastd is not there"), 0u);
  for (std::size_t round = 1; round <= 2; ++round) {
    daemon->kill();
    EXPECT_TRUE(has_daemon("false"));
    EXPECT_TRUE(other_.eventually([&] { return said("agnocastd is not there") == round; }));
    begin();
    EXPECT_TRUE(has_daemon("true"));
    EXPECT_TRUE(other_.eventually([&] { return said("agnocastd is there again") == round; }));
  }
  // A bridge that starts without a daemon.
  daemon->kill();
  EXPECT_TRUE(other_.eventually([&] { return said("agnocastd is not there") == 3; }));
  bridge_.reset();
  start_bridge({"--status-socket", status_path});
  EXPECT_TRUE(has_daemon("false"));
  EXPECT_TRUE(other_.eventually([&] { return said("agnocastd is not there") >= 4; }));
  begin();
  EXPECT_TRUE(has_daemon("true"));
  auto publisher = create_publisher<String>(PlainNode(), topic(), 10);
  DdsReader& reader = other_.reads<String>("rt" + topic(), {});
  EXPECT_TRUE(other_.eventually([&] { return is_out(reader, *publisher); }));
}

}  // namespace
}  // namespace agnocast::test
