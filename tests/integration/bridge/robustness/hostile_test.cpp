// SPDX-License-Identifier: Apache-2.0
//
// Goal: a hostile participant in DDS costs the bridge bounded memory, and affects only its own
// endpoints and messages: other routes go on both ways, and refusals are counted by their reason.
// Method: hostile_peer, a process that sends raw payloads and announces anything, on the loopback
// device; beside it a topic with a publisher and a subscription of this host and an honest
// participant, on which messages go on.

#include <tests/integration/bridge/routes/bridge_side.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/spun.hpp>

#include <agnocast/agnocast.hpp>
#include <bridge/dds/limits.hpp>
#include <bridge/dds/ros_graph.hpp>
#include <bridge/plan/routes.hpp>

#include <example_interfaces/srv/add_two_ints.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/string.hpp>
#include <visualization_msgs/msg/marker_array.hpp>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include <cstdlib>
#include <fstream>
#include <string>

namespace agnocast::test {
namespace {

using bridge::Limit;
using bridge::most_of;
using std_msgs::msg::String;
using AddTwoInts = example_interfaces::srv::AddTwoInts;
using Json = nlohmann::json;

const std::string string_type = "std_msgs::msg::dds_::String_";

class HostileDds : public BridgeTest {
 protected:
  void SetUp() override {
    start_bridge({"--status-socket", status_path()});
    out_ = create_publisher<String>(PlainNode(), beside() + "_out", QoS(100));
    in_ = create_subscription<String>(PlainNode(), beside() + "_in", QoS(100));
    reader_ = &other_.reads<String>("rt" + beside() + "_out", keep_last(100));
    writer_ = &other_.writes("rt" + beside() + "_in", string_type, keep_last(100));
    ASSERT_TRUE(other_.eventually([&] {
      return reader_->matched() == 1 && writer_->matched() == 1 &&
             out_->get_linked_subscription_count() == 1 && is_still_bridging();
    }));
  }
  static std::string status_path() { return daemon->directory() + "/hostile.sock"; }
  static Json status() { return Json::parse(status_at(status_path()), nullptr, false); }
  static std::uint64_t refused(Limit limit) {
    const Json now = status();
    if (!now.is_object() || !now.contains("limits")) return 0;
    return now["limits"][static_cast<std::size_t>(limit)]["refused"];
  }
  static DdsQos keep_last(std::int32_t depth) {
    DdsQos qos;
    qos.depth = depth;
    return qos;
  }
  std::string beside() const { return topic() + "_beside"; }

  /// Returns whether a message each way arrives.
  bool is_still_bridging() {
    const std::string text = "number " + std::to_string(++number_);
    auto loan = out_->borrow_loaned_message();
    loan->data = text;
    if (!out_->publish(std::move(loan))) return false;
    String message;
    message.data = text;
    if (!Other::write(*writer_, message, static_cast<std::int64_t>(number_))) return false;
    bool is_out = false, is_in = false;
    return other_.eventually([&] {
      while (const auto heard = other_.take<String>(*reader_, std::chrono::milliseconds(1)))
        is_out |= heard->data == text;
      while (const auto heard = in_->take()) is_in |= heard->data == text;
      return is_out && is_in;
    });
  }
  /// Returns the bridge's peak memory, private and shared. Its own heap counts with the touched
  /// pages.
  std::size_t peak_bytes() const {
    std::ifstream file("/proc/" + std::to_string(bridge_->pid()) + "/status");
    for (std::string line; std::getline(file, line);) {
      if (line.starts_with("VmHWM:")) return std::stoul(line.substr(6)) * 1024;
    }
    return SIZE_MAX;
  }
  std::string ask(const std::string& line) {
    peer_->tell(line);
    return peer_->answer(120);
  }

  static std::unique_ptr<SteeredProcess> make_peer() {
    return std::make_unique<SteeredProcess>(
        std::vector<std::string>{AGNOCAST_HOSTILE_PEER, std::to_string(domain->id())},
        std::vector<std::string>{"CYCLONEDDS_URI=" + Domain::configuration("10 s")});
  }

  std::unique_ptr<SteeredProcess> peer_ = make_peer();
  Publisher<String>::SharedPtr out_;
  PollingSubscriber<String>::SharedPtr in_;
  DdsReader* reader_ = nullptr;
  DdsWriter* writer_ = nullptr;
  std::size_t number_ = 0;
};

constexpr std::size_t mebibyte = bridge::mebibyte;

TEST_F(HostileDds, MalformedPayloadsOfEveryTypeAreCountedAndNothingElse) {
  const auto strings = create_subscription<String>(PlainNode(), topic() + "_s", QoS(10));
  const auto clouds =
      create_subscription<sensor_msgs::msg::PointCloud2>(PlainNode(), topic() + "_c", QoS(10));
  const auto markers = create_subscription<visualization_msgs::msg::MarkerArray>(
      PlainNode(), topic() + "_m", QoS(10));
  const auto malformed = [&](const std::string& name) {
    const Json now = status();
    for (const Json& dds_reader : now.is_object() ? now["dds_readers"] : Json::array())
      if (dds_reader["topic"] == name) return dds_reader["malformed"].get<std::size_t>();
    return std::size_t{0};
  };
  const struct {
    const char* suffix;
    std::string type;
  } kinds[] = {{"_s", string_type},
               {"_c", dds_type_name<sensor_msgs::msg::PointCloud2>()},
               {"_m", dds_type_name<visualization_msgs::msg::MarkerArray>()}};
  for (const auto& kind : kinds) {
    const std::string suffix = kind.suffix;
    // Repeated, since the bridge may discover the writer after its first payloads.
    EXPECT_TRUE(other_.eventually([&] {
      const std::string sent = ask("malform " + dds_topic() + suffix + " " + kind.type);
      return sent.starts_with("sent ") && std::stoul(sent.substr(5)) > 200 &&
             malformed(topic() + suffix) >= std::stoul(sent.substr(5));
    })) << malformed(topic() + suffix);
    EXPECT_TRUE(is_still_bridging());
  }
  EXPECT_FALSE(strings->take());
  EXPECT_FALSE(clouds->take());
  EXPECT_FALSE(markers->take());
  EXPECT_LT(peak_bytes(), 300 * mebibyte);
}

TEST_F(HostileDds, TenThousandEndpointsAreFollowedUpToALimit) {
  // Cyclone DDS has at most some 8,000 in one process.
  const auto second = make_peer();
  ASSERT_EQ(ask("endpoints 5000"), "made");
  second->tell("endpoints 5000");
  ASSERT_EQ(second->answer(120), "made");
  const std::size_t beyond = 10'000 - 2 * most_of(Limit::endpoints_of_participant);
  EXPECT_TRUE(other_.eventually([&] { return refused(Limit::endpoints_of_participant) >= beyond; }))
      << refused(Limit::endpoints_of_participant);
  EXPECT_TRUE(is_still_bridging());
  EXPECT_LT(peak_bytes(), 400 * mebibyte);
  EXPECT_GE(said("limit exceeded"), 1u);
  ASSERT_EQ(ask("forget"), "forgotten");
  // Its places are free again.
  const auto subscription = create_subscription<String>(PlainNode(), topic(), QoS(10));
  ASSERT_EQ(ask("flood " + dds_topic() + " " + string_type + " reliable,5 10 5"), "sent 5");
  EXPECT_TRUE(take_soon(subscription));
  EXPECT_TRUE(is_still_bridging());
}

TEST_F(HostileDds, EndpointsThatComeAndGoFastDelayNobody) {
  auto publisher = create_publisher<String>(PlainNode(), topic(), QoS(5).transient_local());
  const auto subscription = create_subscription<String>(PlainNode(), topic(), QoS(1000));
  peer_->tell("churn " + dds_topic() + " " + string_type + " 1000");
  for (int i = 0; i < 20; ++i) EXPECT_TRUE(is_still_bridging()) << i;
  EXPECT_EQ(peer_->answer(300), "done");
  EXPECT_TRUE(is_still_bridging());
  // An honest writer finds its place.
  DdsWriter& writer = other_.writes(dds_topic(), string_type, keep_last(10));
  String message;
  message.data = "honest";
  std::int64_t time = 0;
  EXPECT_TRUE(other_.eventually([&] {
    (void)Other::write(writer, message, ++time);
    other_.look(std::chrono::milliseconds(10));
    while (const auto heard = subscription->take())
      if (heard->data == "honest") return true;
    return false;
  }));
  EXPECT_LT(peak_bytes(), 400 * mebibyte);
}

TEST_F(HostileDds, OneParticipantLeavesPlacesOfATopicToOthers) {
  const auto subscription = create_subscription<String>(PlainNode(), topic(), QoS(1000));
  ASSERT_EQ(ask("others " + dds_topic() + " " + string_type + " 200"), "made");
  const auto remote_publishers = [&] {
    const Json now = status();
    std::size_t count = 0;
    for (const Json& remote_publisher : now.is_object() ? now["remote_publishers"] : Json::array())
      count += remote_publisher["topic"] == topic();
    return count;
  };
  ASSERT_TRUE(other_.eventually(
      [&] { return remote_publishers() == bridge::remote_publishers_per_topic_max; }));
  DdsWriter& writer = other_.writes(dds_topic(), string_type, keep_last(10));
  String message;
  message.data = "honest";
  std::int64_t time = 0;
  bool is_heard = false;
  EXPECT_TRUE(other_.eventually([&] {
    (void)Other::write(writer, message, ++time);
    other_.look(std::chrono::milliseconds(10));
    while (const auto heard = subscription->take()) is_heard |= heard->data == "honest";
    return is_heard;
  })) << "the hostile participant has all places";
  EXPECT_TRUE(is_still_bridging());
}

TEST_F(HostileDds, AFloodOfALargeKeepAllHistoryIsBoundedInMemory) {
  const auto never_reads = create_subscription<String>(PlainNode(), topic(), QoS(1).keep_all(5));
  peer_->tell("flood " + dds_topic() + " " + string_type + " reliable,all 1000000 1500");
  for (int i = 0; i < 10; ++i) EXPECT_TRUE(is_still_bridging()) << i;
  EXPECT_EQ(peer_->answer(300).substr(0, 5), "sent ");
  EXPECT_TRUE(is_still_bridging());
  EXPECT_LT(peak_bytes(), 900 * mebibyte) << "1,500 MB were sent";
}

TEST_F(HostileDds, AFloodOfSmallMessagesDoesNotStarveOtherRoutes) {
  const auto subscription =
      create_subscription<String>(PlainNode(), topic(), QoS(10).best_effort());
  peer_->tell("flood " + dds_topic() + " " + string_type + " best,1 20 300000");
  for (int i = 0; i < 20; ++i) EXPECT_TRUE(is_still_bridging()) << i;
  EXPECT_EQ(peer_->answer(300), "sent 300000");
  EXPECT_TRUE(is_still_bridging());
  EXPECT_LT(peak_bytes(), 500 * mebibyte);
}

TEST_F(HostileDds, AHistoryTakesNoMoreOfTheHeapThanItsShare) {
  const auto subscription =
      create_subscription<String>(PlainNode(), topic(), QoS(1).transient_local());
  // 400 MB, which the writer claims to keep.
  EXPECT_EQ(
      ask("history " + dds_topic() + " " + string_type + " reliable,transient,1000 2000000 200"),
      "sent 200");
  EXPECT_TRUE(
      other_.eventually([&] { return refused(Limit::history_bytes_of_remote_publisher) > 0; }));
  EXPECT_TRUE(is_still_bridging());
  EXPECT_TRUE(take_soon(subscription)) << "the newest messages still arrive";
}

TEST_F(HostileDds, LiesAboutNodesCostABoundedGraphAndOnlyTheirOwnNames) {
  // An honest writer's node is known from its participant's announcement.
  const auto honest =
      bridge::RosGraph::create(other_.participant(), bridge::RosGraph::Speak::iron).value();
  ASSERT_TRUE(honest->set_nodes({{"/", "honest", {}, {writer_->guid()}}}));
  const std::string sent = ask("nodes");
  ASSERT_TRUE(sent.starts_with("sent ")) << sent;
  // All but the last, of 40,000 nodes, are refused.
  EXPECT_TRUE(other_.eventually([&] {
    const Json now = status();
    return now.is_object() && now["discovery_info_refused"] == std::stoul(sent.substr(5)) - 1;
  })) << status()["discovery_info_refused"]
      << " of " << sent;
  EXPECT_TRUE(is_still_bridging());
  EXPECT_TRUE(other_.eventually([&] {
    const Json now = status();
    for (const Json& remote_publisher : now.is_object() ? now["remote_publishers"] : Json::array())
      if (remote_publisher["topic"] == beside() + "_in" && remote_publisher["node"] == "/honest")
        return true;
    return false;
  }));
  EXPECT_LT(peak_bytes(), 400 * mebibyte);
}

TEST_F(HostileDds, WrongTypesUnderRightNamesAreReportedAndRightOnesGoOn) {
  auto publisher = create_publisher<String>(PlainNode(), topic(), QoS(10));
  const auto subscription = create_subscription<String>(PlainNode(), topic(), QoS(10));
  ASSERT_EQ(ask("others " + dds_topic() + " std_msgs::msg::dds_::Int32_ 300"), "made");
  EXPECT_TRUE(other_.eventually([&] {
    const Json now = status();
    std::size_t count = 0;
    for (const Json& each : now.is_object() ? now["unbridged"] : Json::array())
      count += each["topic"] == topic() && each["why"] == "other_type";
    return count == 2;
  }));
  DdsReader& reader = other_.reads<String>(dds_topic(), keep_last(10));
  EXPECT_TRUE(other_.eventually([&] { return publisher->get_linked_subscription_count() == 2; }));
  EXPECT_TRUE(other_.eventually([&] { return reader.matched() == 1; }));
  EXPECT_TRUE(is_still_bridging());
}

TEST_F(HostileDds, RequestsOfOneClientLeavePlacesToOthers) {
  const Spun<PlainNode> node;
  const auto service =
      create_service<AddTwoInts>(node, topic(),
                                 [](const ipc_shared_ptr<const AddTwoInts::Request>& request,
                                    const ipc_shared_ptr<AddTwoInts::Response>& response) {
                                   response->sum = request->a + request->b;
                                 });
  // 500 MB, of a client without a reader for responses.
  peer_->tell("ask " + topic() + " 5000 100000");
  for (int i = 0; i < 10; ++i) EXPECT_TRUE(is_still_bridging()) << i;
  EXPECT_EQ(peer_->answer(300), "sent 5000");
  // Small ones, until all places are taken.
  EXPECT_TRUE(other_.eventually([&] {
    EXPECT_EQ(ask("ask " + topic() + " 3000 0"), "sent 3000");
    return refused(Limit::requests) > 0;
  }));
  // An honest client is answered while the other one floods.
  DdsQos qos = keep_last(100);
  qos.user_data = "clientid=honest;";
  DdsReader& answers = other_.reads("rr" + topic() + "Reply",
                                    "example_interfaces::srv::dds_::AddTwoInts_Response_", qos);
  DdsWriter& asks = other_.writes("rq" + topic() + "Request",
                                  "example_interfaces::srv::dds_::AddTwoInts_Request_", qos);
  ASSERT_TRUE(other_.eventually([&] { return answers.matched() == 1 && asks.matched() == 1; }));
  peer_->tell("ask " + topic() + " 5000 0");
  Bytes request(36);
  request[1] = std::byte{1};
  for (const auto& [at, value] : {std::pair(4, 5), {12, 1}, {20, 2}, {28, 3}})
    request[static_cast<std::size_t>(at)] = std::byte(value);
  ASSERT_TRUE(send(asks, request));
  // All clients of a service share the topic of its responses.
  for (;;) {
    const auto answer = other_.take<Received>(answers);
    ASSERT_NE(answer, nullptr) << "the flood has taken its place";
    ASSERT_GE(answer->bytes.size(), 28u);
    if (answer->bytes[4] != std::byte{5}) continue;
    EXPECT_EQ(answer->bytes[20], std::byte{5}) << "2 + 3";
    break;
  }
  EXPECT_EQ(peer_->answer(300), "sent 5000");
  EXPECT_LT(peak_bytes(), 500 * mebibyte);
  EXPECT_TRUE(is_still_bridging());
}

TEST_F(HostileDds, DuplicateAndForeignResponsesOfAServerAreDropped) {
  ASSERT_EQ(ask("serve " + topic()), "serves");
  const Spun<PlainNode> node;
  const auto client = create_client<AddTwoInts>(node, topic());
  ASSERT_TRUE(client->wait_for_service(std::chrono::seconds(60)));
  constexpr std::int64_t calls = 50;
  for (std::int64_t i = 0; i < calls; ++i) {
    auto request = client->borrow_loaned_request();
    request->a = i;
    request->b = 1'000;
    auto sent = client->async_send_request(std::move(request));
    ASSERT_EQ(sent.future.wait_for(std::chrono::seconds(60)), std::future_status::ready) << i;
    EXPECT_EQ(sent.future.get()->sum, i + 1'000);
  }
  EXPECT_TRUE(other_.eventually([&] {
    const Json now = status();
    for (const Json& each : now.is_object() ? now["services"] : Json::array()) {
      if (each["service"] == topic() && each["responses"] == calls &&
          each["unasked"] == 3 * calls && each["malformed"] == calls)
        return true;
    }
    return false;
  })) << status()["services"].dump(1);
  EXPECT_TRUE(is_still_bridging());
}

TEST_F(HostileDds, NoiseAtItsPortsIsIgnored) {
  // RTPS 2.3, 9.6.1: the ports of the domain's first participants, for discovery and for messages.
  const std::size_t base = 7'400 + 250 * domain->id();
  for (std::size_t i = 0; i < 8; ++i) {
    for (const std::size_t kind : {10U, 11U})
      ASSERT_EQ(ask("garbage " + std::to_string(base + kind + 2 * i) + " 3000"), "sent");
    EXPECT_TRUE(is_still_bridging()) << i;
  }
  EXPECT_LT(peak_bytes(), 400 * mebibyte);
}

}  // namespace
}  // namespace agnocast::test
