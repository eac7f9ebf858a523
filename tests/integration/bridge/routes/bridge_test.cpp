// SPDX-License-Identifier: Apache-2.0
//
// Goal: a message published on this host with agnocast arrives in DDS as a ROS 2 node would have
// written it, and the other way round, once each, with its history and in the name of its node;
// and the bridge may die.
// Method: the real agnocastd and agnocast-bridge; this process has the agnocast endpoints, and is
// the other participant in DDS, on the loopback interface and in a domain of its own.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <bridge/dds/ros_graph.hpp>

#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/string.hpp>

#include <gmock/gmock.h>

#include <signal.h>

#include <chrono>
#include <cstring>
#include <fstream>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::bridge {
namespace {

using namespace std::chrono_literals;
using std_msgs::msg::String;
using test::BridgeTest;
using test::Other;
using test::PlainNode;
using testing::Contains;
using testing::ElementsAre;
using testing::IsEmpty;
using Cloud = sensor_msgs::msg::PointCloud2;

DdsQos keep_last(std::int32_t depth) {
  DdsQos qos;
  qos.depth = depth;
  return qos;
}
DdsQos best_effort(std::int32_t depth) {
  DdsQos qos = keep_last(depth);
  qos.reliable = false;
  return qos;
}
DdsQos history(std::int32_t depth) {
  DdsQos qos = keep_last(depth);
  qos.transient_local = true;
  return qos;
}

String text(const std::string& data) {
  String message;
  message.data = data;
  return message;
}

TEST_F(BridgeTest, ForwardsMessagesToDdsInTheirOrder) {
  DdsReader& reader = other_.reads<String>(dds_topic(), keep_last(100));
  auto publisher = create_publisher<String>(PlainNode(), topic(), 100);
  ASSERT_TRUE(other_.eventually([&] { return is_out(reader, *publisher); }));
  for (int i = 0; i < 50; ++i) {
    auto loan = publisher->borrow_loaned_message();
    loan->data = "message " + std::to_string(i);
    ASSERT_TRUE(publisher->publish(std::move(loan)));
  }
  std::int64_t newest_ns = 0;
  for (int i = 0; i < 50; ++i) {
    const auto got = other_.take<String>(reader);
    ASSERT_NE(got, nullptr) << i;
    EXPECT_EQ(got->data, "message " + std::to_string(i));
    EXPECT_GT(other_.last().source_time_ns, newest_ns) << "Fast DDS would give it before others";
    newest_ns = other_.last().source_time_ns;
  }
  EXPECT_EQ(other_.take<String>(reader, 200ms), nullptr) << "once each";
}

TEST_F(BridgeTest, ForwardsMessagesFromDdsToSharedMemory) {
  auto subscription = create_subscription<String>(PlainNode(), topic(), 100);
  DdsWriter& writer = other_.writes(dds_topic(), test::dds_type_name<String>(), keep_last(100));
  ASSERT_TRUE(other_.eventually([&] { return writer.matched() == 1; }));
  for (int i = 0; i < 50; ++i)
    ASSERT_TRUE(Other::write(writer, text("message " + std::to_string(i))));
  for (int i = 0; i < 50; ++i) {
    const auto got = test::take_soon(subscription);
    ASSERT_TRUE(got) << i;
    EXPECT_EQ(got->data, "message " + std::to_string(i));
  }
  std::this_thread::sleep_for(200ms);
  EXPECT_FALSE(subscription->take()) << "once each";
}

TEST_F(BridgeTest, ForwardsMegabytesBothWaysUnchanged) {
  DdsReader& reader = other_.reads<Cloud>(dds_topic() + "_out", keep_last(10));
  auto publisher = create_publisher<Cloud>(PlainNode(), topic() + "_out", 10);
  auto subscription = create_subscription<Cloud>(PlainNode(), topic() + "_in", 10);
  DdsWriter& writer =
      other_.writes(dds_topic() + "_in", test::dds_type_name<Cloud>(), keep_last(10));
  ASSERT_TRUE(
      other_.eventually([&] { return is_out(reader, *publisher) && writer.matched() == 1; }));
  Cloud cloud;
  cloud.header.frame_id = "lidar";
  cloud.fields.resize(5);
  for (std::size_t i = 0; i < 5; ++i) cloud.fields[i].name = "field " + std::to_string(i);
  cloud.data.resize(4'000'001);
  for (std::size_t i = 0; i < cloud.data.size(); ++i)
    cloud.data[i] = static_cast<std::uint8_t>(i * 7 + i / 251);
  auto loan = publisher->borrow_loaned_message();
  *loan = cloud;
  ASSERT_TRUE(publisher->publish(std::move(loan)));
  const auto out = other_.take<Cloud>(reader);
  ASSERT_NE(out, nullptr);
  EXPECT_TRUE(*out == cloud);
  ASSERT_TRUE(Other::write(writer, cloud));
  const auto in = test::take_soon(subscription);
  ASSERT_TRUE(in);
  EXPECT_TRUE(*in == cloud);
}

TEST_F(BridgeTest, ForwardsTheLastMessagesOfAnEndedPublisher) {
  DdsReader& reader = other_.reads<String>(dds_topic(), keep_last(100));
  for (int i = 0; i < 5; ++i) {
    auto publisher = create_publisher<String>(PlainNode(), topic(), 100);
    ASSERT_TRUE(other_.eventually([&] { return is_out(reader, *publisher); }));
    for (int j = 0; j < 20; ++j) {
      auto loan = publisher->borrow_loaned_message();
      loan->data = std::to_string(20 * i + j);
      ASSERT_TRUE(publisher->publish(std::move(loan)));
    }
    publisher.reset();
    for (int j = 0; j < 20; ++j) {
      const auto got = other_.take<String>(reader);
      ASSERT_NE(got, nullptr) << i << ' ' << j;
      EXPECT_EQ(got->data, std::to_string(20 * i + j));
    }
    ASSERT_TRUE(other_.eventually([&] { return reader.matched() == 0; })) << "the writer stays";
  }
}

TEST_F(BridgeTest, ForwardsTheLastMessagesOfAnEndedWriter) {
  auto subscription = create_subscription<String>(PlainNode(), topic(), 100);
  for (int i = 0; i < 5; ++i) {
    auto writer = other_.participant().create_writer(dds_topic(), test::dds_type_name<String>(),
                                                     keep_last(100));
    ASSERT_TRUE(other_.eventually([&] { return (*writer)->matched() == 1; }));
    for (int j = 0; j < 20; ++j)
      ASSERT_TRUE(Other::write(**writer, text(std::to_string(20 * i + j))));
    writer->reset();
    for (int j = 0; j < 20; ++j) {
      const auto got = test::take_soon(subscription);
      ASSERT_TRUE(got) << i << ' ' << j;
      EXPECT_EQ(got->data, std::to_string(20 * i + j));
    }
  }
}

// Writers that come and go while the bridge does not plan.
class ShortLived : public BridgeTest {
 protected:
  void SetUp() override {
    start_bridge({"--status-socket", socket_});
    // A writer here is matched as soon as it is made, once the bridge's reader is known.
    make_writer().reset();
  }
  std::unique_ptr<DdsWriter> make_writer() {
    auto writer = other_.participant().create_writer(dds_topic(), test::dds_type_name<String>(),
                                                     keep_last(100));
    EXPECT_TRUE(other_.eventually([&] { return (*writer)->matched() == 1; }));
    return std::move(*writer);
  }
  void lives_and_goes() {
    auto writer = make_writer();
    for (int i = 0; i < 20; ++i) ASSERT_TRUE(Other::write(*writer, text(std::to_string(i))));
    writer.reset();  // waits until all of them are acknowledged
    // Time for Cyclone in the bridge to notice its end; where this is too short, the test covers
    // less.
    std::this_thread::sleep_for(300ms);
  }
  void expect_all() {
    for (int i = 0; i < 20; ++i) {
      const auto got = test::take_soon(subscription_);
      ASSERT_TRUE(got) << i;
      EXPECT_EQ(got->data, std::to_string(i));
    }
  }
  std::string status() const { return status_at(socket_); }

 private:
  const std::string socket_ = daemon->directory() + "/short-lived.sock";
  Subscription<String>::SharedPtr subscription_ =
      create_subscription<String>(PlainNode(), topic(), 100);
};

TEST_F(ShortLived, WhileItPlans) {
  auto other_subscription = create_subscription<String>(PlainNode(), topic() + "_other", 1);
  ASSERT_TRUE(other_.eventually(
      [&] { return other_.remote_count(dds_topic() + "_other", Remote::Kind::reader) == 1; }));
  // The plan for this one waits for agnocastd.
  const pid_t waits_for = daemon->kill_worker(SIGSTOP);
  other_.writes(dds_topic() + "_other", test::dds_type_name<String>(), {});
  EXPECT_TRUE(other_.eventually([&] { return status().empty(); }));
  lives_and_goes();
  ASSERT_EQ(::kill(waits_for, SIGCONT), 0);
  expect_all();
}

TEST_F(ShortLived, WhileAgnocastdIsAway) {
  ASSERT_EQ(::kill(daemon->supervisor_pid(), SIGSTOP), 0);
  const pid_t old = daemon->kill_worker();
  EXPECT_TRUE(other_.eventually(
      [&] { return status().find("\"has_daemon\":false") != std::string::npos; }));
  lives_and_goes();
  ASSERT_EQ(::kill(daemon->supervisor_pid(), SIGCONT), 0);
  ASSERT_TRUE(daemon->wait_for_next(old));
  expect_all();
}

TEST_F(BridgeTest, KeepsAllMessagesForASlowKeepAllSubscription) {
  auto subscription = create_subscription<String>(PlainNode(), topic(), QoS(1).keep_all(5));
  DdsQos keep_all;
  keep_all.keep_all = true;
  keep_all.blocking_max = test::patience;
  DdsWriter& writer = other_.writes(dds_topic(), test::dds_type_name<String>(), keep_all);
  ASSERT_TRUE(other_.eventually([&] { return writer.matched() == 1; }));
  // More than the subscription has room for, and than a keep-last history would have.
  constexpr int count = 300;
  for (int i = 0; i < count; ++i) ASSERT_TRUE(Other::write(writer, text(std::to_string(i))));
  for (int i = 0; i < count; ++i) {
    const auto got = test::take_soon(subscription);
    ASSERT_TRUE(got) << i;
    ASSERT_EQ(got->data, std::to_string(i));
  }
}

TEST_F(BridgeTest, ReportsAMalformedMessageAndGoesOn) {
  auto subscription = create_subscription<String>(PlainNode(), topic(), 100);
  DdsWriter& writer = other_.writes(dds_topic(), test::dds_type_name<String>(), keep_last(100));
  ASSERT_TRUE(other_.eventually([&] { return writer.matched() == 1; }));
  const auto lie = [](std::span<std::byte> room) {
    constexpr unsigned char length_of_a_gigabyte[] = {0, 1, 0, 0, 0, 0, 0, 64, 'a', 'b', 'c', 0};
    std::memcpy(room.data(), length_of_a_gigabyte, sizeof length_of_a_gigabyte);
    return sizeof length_of_a_gigabyte;
  };
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(writer.write(12, lie, 1));
  ASSERT_TRUE(Other::write(writer, text("good")));
  const auto got = test::take_soon(subscription);
  ASSERT_TRUE(got);
  EXPECT_EQ(got->data, "good");
  const std::string log = bridge_log();
  EXPECT_THAT(log, testing::HasSubstr("malformed message topic=" + topic()));
  EXPECT_THAT(log, testing::HasSubstr("at byte 4 in data"));
  EXPECT_EQ(log.find("malformed message"), log.rfind("malformed message"))
      << "logged less often than another host sends them";
}

TEST_F(BridgeTest, NeverReturnsAMessageToItsOwnSide) {
  // Both sides publish and subscribe on one topic.
  auto publisher = create_publisher<String>(PlainNode(), topic(), 100);
  auto subscription = create_subscription<String>(PlainNode(), topic(), 100);
  DdsReader& reader = other_.reads<String>(dds_topic(), keep_last(100));
  DdsWriter& writer = other_.writes(dds_topic(), test::dds_type_name<String>(), keep_last(100));
  // The subscription here, and the bridge's.
  ASSERT_TRUE(
      other_.eventually([&] { return is_out(reader, *publisher, 2) && writer.matched() == 1; }));
  for (int i = 0; i < 20; ++i) {
    auto loan = publisher->borrow_loaned_message();
    loan->data = "here";
    ASSERT_TRUE(publisher->publish(std::move(loan)));
    ASSERT_TRUE(Other::write(writer, text("there")));
  }
  std::vector<std::string> out, in;
  while (const auto got = other_.take<String>(reader, 500ms)) out.push_back(got->data);
  while (const auto got = subscription->take()) in.push_back(got->data);
  EXPECT_EQ(out, std::vector<std::string>(20, "here"));
  EXPECT_EQ(std::count(in.begin(), in.end(), "here"), 20) << "directly";
  EXPECT_EQ(std::count(in.begin(), in.end(), "there"), 20) << "through the bridge";
  EXPECT_EQ(in.size(), 40u);
}

TEST_F(BridgeTest, ForwardsHistoryBothWays) {
  auto publisher =
      create_publisher<String>(PlainNode(), topic() + "_out", QoS(3).transient_local());
  for (int i = 0; i < 5; ++i) {
    auto loan = publisher->borrow_loaned_message();
    loan->data = std::to_string(i);
    ASSERT_TRUE(publisher->publish(std::move(loan)));
  }
  DdsReader& reader = other_.reads<String>(dds_topic() + "_out", history(10));
  for (const char* const expected : {"2", "3", "4"}) {
    const auto got = other_.take<String>(reader);
    ASSERT_NE(got, nullptr);
    EXPECT_EQ(got->data, expected);
  }

  DdsWriter& writer = other_.writes(dds_topic() + "_in", test::dds_type_name<String>(), history(3));
  for (int i = 0; i < 5; ++i) ASSERT_TRUE(Other::write(writer, text(std::to_string(i))));
  auto early = create_subscription<String>(PlainNode(), topic() + "_in", QoS(10).transient_local());
  for (const char* const expected : {"2", "3", "4"}) {
    const auto got = test::take_soon(early);
    ASSERT_TRUE(got);
    EXPECT_EQ(got->data, expected);
  }
  auto late = create_subscription<String>(PlainNode(), topic() + "_in", QoS(10).transient_local());
  const auto first = test::take_soon(late);
  ASSERT_TRUE(first);
  EXPECT_EQ(first->data, "2");
}

TEST_F(BridgeTest, KeepsBestEffortBestEffort) {
  auto publisher = create_publisher<String>(PlainNode(), topic(), QoS(5).best_effort());
  DdsReader& strict = other_.reads<String>(dds_topic(), keep_last(5));
  DdsReader& easy = other_.reads<String>(dds_topic(), best_effort(5));
  ASSERT_TRUE(other_.eventually([&] { return easy.matched() == 1; }));
  EXPECT_EQ(strict.matched(), 0u);
  bool is_best_effort = false;
  for (const auto& [guid, remote] : other_.participant().remotes())
    is_best_effort |= remote.topic == dds_topic() && !remote.qos.reliable;
  EXPECT_TRUE(is_best_effort);
}

TEST_F(BridgeTest, PassesDeadlinesAndLifespansOn) {
  const auto with_deadline = [](std::chrono::nanoseconds deadline) {
    DdsQos qos = keep_last(5);
    qos.deadline = deadline;
    return qos;
  };
  auto publisher =
      create_publisher<String>(PlainNode(), topic() + "_out", QoS(5).deadline(1h).lifespan(2h));
  DdsReader& reader = other_.reads<String>(dds_topic() + "_out", with_deadline(1h));
  DdsReader& stricter = other_.reads<String>(dds_topic() + "_out", with_deadline(59min));
  EXPECT_TRUE(
      other_.eventually([&] { return reader.matched() == 1 && stricter.incompatible() == 1; }));
  EXPECT_TRUE(other_.eventually([&] {
    const auto& remotes = other_.participant().remotes();
    return std::any_of(remotes.begin(), remotes.end(), [&](const auto& remote) {
      return remote.second.topic == dds_topic() + "_out" && remote.second.qos.lifespan == 2h;
    });
  }));

  other_.writes(dds_topic() + "_in", test::dds_type_name<String>(), with_deadline(1h));
  auto fits = create_subscription<String>(PlainNode(), topic() + "_in", QoS(5).deadline(1h));
  auto strict = create_subscription<String>(PlainNode(), topic() + "_in", QoS(5).deadline(59min));
  EXPECT_TRUE(other_.eventually([&] { return fits->get_linked_publisher_count() == 1; }));
  EXPECT_TRUE(other_.eventually([&] {
    return strict->get_incompatible_qos_status().last_policy_kind == QosPolicyKind::deadline;
  }));
  EXPECT_EQ(strict->get_linked_publisher_count(), 0u);
}

TEST_F(BridgeTest, AnnouncesAPublisherAndReadsItOnlyForAReaderInDds) {
  auto publisher = create_publisher<String>(PlainNode(), topic(), QoS(3).transient_local());
  const auto writers = [&] {
    std::set<Guid> guids;
    for (const auto& [guid, remote] : other_.participant().remotes())
      if (remote.topic == dds_topic() && remote.kind == Remote::Kind::writer) guids.insert(guid);
    return guids;
  };
  ASSERT_TRUE(other_.eventually([&] { return writers().size() == 1; }));
  const Guid announced = *writers().begin();
  const Remote& told = other_.participant().remotes().at(announced);
  EXPECT_EQ(told.type, test::dds_type_name<String>());
  EXPECT_TRUE(told.qos.reliable && told.qos.transient_local);
  EXPECT_EQ(told.qos.depth, 3);
  auto graph = RosGraph::create(other_.participant(), RosGraph::Speak::humble).value();
  EXPECT_TRUE(other_.eventually([&] {
    EXPECT_TRUE(graph->update());
    for (const auto& [participant, entities] : graph->others()) {
      for (const RosNode& node : entities.nodes) {
        if (node.name == "node" && node.writers == std::vector<Guid>{announced}) return true;
      }
    }
    return false;
  })) << "no node owns it";
  const auto say = [&](const std::string& text) {
    auto loan = publisher->borrow_loaned_message();
    loan->data = text;
    EXPECT_TRUE(publisher->publish(std::move(loan)));
  };
  for (int round = 1; round <= 2; ++round) {
    EXPECT_EQ(publisher->get_linked_subscription_count(), 0u) << "the bridge subscribes for nobody";
    const Guid before = *writers().begin();
    say("history " + std::to_string(round));
    {
      DdsQos qos;
      qos.transient_local = true;
      qos.depth = 10;
      DdsReader& reader = other_.reads<String>(dds_topic(), qos);
      for (int i = 1; i <= round; ++i) {
        const auto heard = other_.take<String>(reader);
        ASSERT_NE(heard, nullptr);
        EXPECT_EQ(heard->data, "history " + std::to_string(i)) << "each once, in its order";
        EXPECT_EQ(other_.last().writer, before) << "not from the announced writer";
      }
      ASSERT_TRUE(
          other_.eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
      EXPECT_EQ(other_.take<String>(reader, std::chrono::milliseconds(300)), nullptr);
      other_.forget();
    }
    ASSERT_TRUE(other_.eventually([&] {
      return publisher->get_linked_subscription_count() == 0 && writers().size() == 1 &&
             !writers().contains(before);
    })) << "the bridge announces a writer again once nobody reads";
  }
  publisher.reset();
  EXPECT_TRUE(other_.eventually([&] { return writers().empty(); }));
}

TEST_F(BridgeTest, HasAWriterOnlyWhileItIsReadIfAnnouncementsAreOff) {
  const std::string file = daemon->directory() + "/quiet.toml";
  std::ofstream(file) << "announce = false\n";
  bridge_.reset();
  start_bridge({"--config", file});
  auto publisher = create_publisher<String>(PlainNode(), topic(), 5);
  auto subscription = create_subscription<String>(PlainNode(), topic(), 5);
  const auto count = [&](Remote::Kind kind) { return other_.remote_count(dds_topic(), kind); };
  ASSERT_TRUE(other_.eventually([&] { return count(Remote::Kind::reader) == 1; }));
  EXPECT_EQ(count(Remote::Kind::writer), 0u);
  auto late = create_publisher<String>(PlainNode(), topic() + "_late", 5);
  {
    auto reader = other_.participant()
                      .create_reader(dds_topic(), test::dds_type_name<String>(), {},
                                     [](RawPieces) { return nullptr; })
                      .value();
    ASSERT_TRUE(other_.eventually([&] { return count(Remote::Kind::writer) == 1; }));
  }
  ASSERT_TRUE(other_.eventually([&] { return count(Remote::Kind::writer) == 0; }));
  EXPECT_EQ(other_.remote_count(dds_topic() + "_late", Remote::Kind::writer), 0u);
  // A new configuration announces existing topics.
  std::ofstream(file) << "announce = true\n";
  ASSERT_EQ(::kill(bridge_->pid(), SIGHUP), 0);
  ASSERT_TRUE(other_.eventually([&] { return count(Remote::Kind::writer) == 1; }));
  std::ofstream(file) << "announce = false\n";
  ASSERT_EQ(::kill(bridge_->pid(), SIGHUP), 0);
  ASSERT_TRUE(other_.eventually([&] { return count(Remote::Kind::writer) == 0; }));
  {
    auto writer =
        other_.participant().create_writer(dds_topic(), test::dds_type_name<String>(), {}).value();
    ASSERT_TRUE(other_.eventually([&] { return writer->matched() == 1; }));
    EXPECT_EQ(count(Remote::Kind::reader), 1u);
    subscription.reset();
    ASSERT_TRUE(other_.eventually([&] { return count(Remote::Kind::reader) == 0; }));
  }
}

// As a node of rclcpp that also uses agnocast does.
TEST_F(BridgeTest, DoesNotAnnounceNodesThatAnnounceThemselves) {
  auto graph = RosGraph::create(other_.participant(), RosGraph::Speak::humble).value();
  auto publisher = create_publisher<String>(PlainNode(), topic(), 5);
  /// The node to which the bridge's writer of the topic belongs; and whether "/ns/node" is there.
  const auto owner = [&](bool& is_announced) {
    EXPECT_TRUE(graph->update());
    std::string found;
    is_announced = false;
    for (const auto& [participant, entities] : graph->others()) {
      for (const RosNode& node : entities.nodes) {
        is_announced |= full_name_of(node) == "/ns/node";
        for (const Guid& writer : node.writers) {
          const auto remote = other_.participant().remotes().find(writer);
          if (remote != other_.participant().remotes().end() && remote->second.topic == dds_topic())
            found = full_name_of(node);
        }
      }
    }
    return found;
  };
  bool is_announced = false;
  ASSERT_TRUE(other_.eventually([&] { return owner(is_announced) == "/ns/node"; }));
  ASSERT_TRUE(graph->set_nodes({{"/ns", "node", {}, {}}, {"/ns", "another", {}, {}}}));
  ASSERT_TRUE(other_.eventually(
      [&] { return owner(is_announced) == "/_agnocast_bridge" && !is_announced; }));
  ASSERT_TRUE(graph->set_nodes({{"/ns", "another", {}, {}}}));
  ASSERT_TRUE(other_.eventually([&] { return owner(is_announced) == "/ns/node"; }));
}

TEST_F(BridgeTest, ShowsNodesWithTheirEndpoints) {
  auto graph = RosGraph::create(other_.participant(), RosGraph::Speak::humble).value();
  auto publisher = create_publisher<String>(PlainNode(), topic(), 5);
  DdsReader& reader = other_.reads<String>(dds_topic(), {});
  std::optional<RosNode> node;
  ASSERT_TRUE(other_.eventually([&] {
    EXPECT_TRUE(graph->update());
    for (const auto& [participant, entities] : graph->others()) {
      for (const RosNode& one : entities.nodes) {
        if (one.name == "node" && one.name_space == "/ns" && !one.writers.empty()) node = one;
      }
    }
    return node.has_value();
  }));
  ASSERT_EQ(node->writers.size(), 1u);
  // DDS announces the writer in its own time.
  ASSERT_TRUE(
      other_.eventually([&] { return other_.participant().remotes().contains(node->writers[0]); }));
  const auto writer = other_.participant().remotes().find(node->writers[0]);
  EXPECT_EQ(writer->second.topic, dds_topic());
  EXPECT_EQ(writer->second.type, test::dds_type_name<String>());
  EXPECT_THAT(node->readers, IsEmpty());
  (void)reader;
}

TEST_F(BridgeTest, MayBeKilledAndGoesOn) {
  auto publisher = create_publisher<String>(PlainNode(), topic(), 5);
  auto subscription = create_subscription<String>(PlainNode(), topic() + "_in", 5);
  DdsReader& reader = other_.reads<String>(dds_topic(), keep_last(1000));
  DdsWriter& writer =
      other_.writes(dds_topic() + "_in", test::dds_type_name<String>(), keep_last(5));
  const auto both_flow = [&] {
    auto loan = publisher->borrow_loaned_message();
    loan->data = "out";
    EXPECT_TRUE(publisher->publish(std::move(loan)));
    EXPECT_TRUE(Other::write(writer, text("in")));
    std::this_thread::sleep_for(20ms);
    bool out = false, in = false;
    while (reader.take()) out = true;
    while (subscription->take()) in = true;
    return out && in;
  };
  ASSERT_TRUE(other_.eventually(both_flow));
  bridge_.reset();  // SIGKILL
  start_bridge();
  EXPECT_TRUE(other_.eventually(both_flow));
}

}  // namespace
}  // namespace agnocast::bridge
