// SPDX-License-Identifier: Apache-2.0
//
// Goal: servers and clients on both sides decide which services are bridged. Method: values.

#include <bridge/plan/service_plan.hpp>

#include <agnocast/service_name.hpp>

#include <gmock/gmock.h>

namespace agnocast::bridge {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::SizeIs;

constexpr const char* add_type = "example_interfaces/srv/AddTwoInts";
const ServiceKey add{"/ns/add", add_type};

class ServicePlans : public testing::Test {
 protected:
  void local(EndpointKind kind, const std::string& node, const std::string& type = add_type) {
    EndpointInfo info;
    info.kind = kind;
    info.topic = request_topic("/ns/add");
    info.type = type + "_Request";
    info.node_name = node;
    info.node_namespace = "/ns";
    locals_.push_back(info);
  }
  void server(const std::string& node) { local(EndpointKind::subscription, node); }
  void client(const std::string& node) { local(EndpointKind::publisher, node); }

  void remote(Remote::Kind kind, bool is_request, std::uint8_t participant,
              const std::string& type = "AddTwoInts") {
    Remote remote;
    remote.kind = kind;
    remote.guid.bytes[0] = participant;
    remote.participant = remote.guid;
    remote.guid.bytes[15] = static_cast<std::uint8_t>(++remote_count_);
    remote.topic = is_request ? "rq/ns/addRequest" : "rr/ns/addReply";
    remote.type =
        "example_interfaces::srv::dds_::" + type + (is_request ? "_Request_" : "_Response_");
    remotes_[remote.guid] = remote;
  }
  void remote_server(std::uint8_t participant, const std::string& type = "AddTwoInts") {
    remote(Remote::Kind::reader, true, participant, type);
    remote(Remote::Kind::writer, false, participant, type);
  }
  ServicePlan plan() {
    return plan_services({0, locals_, &remotes_, rules_, [](const std::string& type) {
                            return type.starts_with(add_type)
                                       ? std::nullopt
                                       : std::optional<std::string>("not found");
                          }});
  }

  std::vector<EndpointInfo> locals_;
  DdsParticipant::Remotes remotes_;
  std::vector<Rule> rules_;
  int remote_count_ = 0;
};

TEST_F(ServicePlans, ServeDdsForAllServersHere) {
  server("one");
  server("two");
  const ServicePlan all = plan();
  ASSERT_THAT(all.served, SizeIs(1));
  EXPECT_THAT(all.served.at(add).nodes, ElementsAre("/ns/one", "/ns/two"));
  EXPECT_THAT(all.asked, IsEmpty());
  EXPECT_THAT(all.unbridged, IsEmpty());
}

TEST_F(ServicePlans, CallServersInDdsForAllClientsHere) {
  client("one");
  client("two");
  remote_server(1);
  const ServicePlan all = plan();
  ASSERT_THAT(all.asked, SizeIs(1));
  EXPECT_THAT(all.asked.at(add).nodes, ElementsAre("/ns/one", "/ns/two"));
  EXPECT_THAT(all.served, IsEmpty());
}

TEST_F(ServicePlans, OfferAServerBeforeAnyClientButNoClientWithoutAServer) {
  server("server");
  EXPECT_THAT(plan().served, SizeIs(1));
  locals_.clear();
  client("client");
  const ServicePlan nothing = plan();
  EXPECT_THAT(nothing.asked, IsEmpty());
  EXPECT_THAT(nothing.unbridged, ElementsAre(Unbridged{"/ns/add", add_type, Direction::inward,
                                                       WhyNot::no_server, "", true}));
}

// Otherwise a request would circulate between two bridges.
TEST_F(ServicePlans, NeverCallAServiceThatIsServedHere) {
  server("server");
  client("client");
  remote_server(2);
  EXPECT_THAT(plan().served, SizeIs(1));
  EXPECT_THAT(plan().asked, IsEmpty());
  EXPECT_THAT(plan().unbridged, IsEmpty());
}

TEST_F(ServicePlans, WaitForBothEndsOfOneParticipant) {
  client("client");
  remote(Remote::Kind::reader, true, 1);   // half a server
  remote(Remote::Kind::writer, false, 2);  // half of another server
  EXPECT_THAT(plan().asked, IsEmpty());
  remote(Remote::Kind::writer, false, 1);
  EXPECT_THAT(plan().asked, SizeIs(1));
}

TEST_F(ServicePlans, IgnoreTheEndpointsOfBridges) {
  server(std::string(bridge_node));
  client(std::string(bridge_node) + "_1");
  remote_server(1);
  const ServicePlan nothing = plan();
  EXPECT_THAT(nothing.served, IsEmpty());
  EXPECT_THAT(nothing.asked, IsEmpty());
  EXPECT_THAT(nothing.unbridged, IsEmpty());
}

TEST_F(ServicePlans, FollowTheRules) {
  client("client");
  remote_server(2);
  rules_ = {{.topic = "/ns/*", .direction = Direction::outward, .line = 3}};
  const ServicePlan all = plan();
  EXPECT_THAT(all.asked, IsEmpty());
  EXPECT_THAT(all.unbridged,
              ElementsAre(Unbridged{"/ns/add", add_type, Direction::inward, WhyNot::rule,
                                    "the rule \"/ns/*\" in line 3", true}));
}

TEST_F(ServicePlans, SayWhichTypeTheServiceHasInDdsAndThatATypeIsUnknown) {
  client("client");
  remote_server(1, "Trigger");
  ASSERT_THAT(plan().unbridged, SizeIs(1));
  EXPECT_EQ(plan().unbridged[0].why, WhyNot::other_type);
  EXPECT_EQ(plan().unbridged[0].detail, "in DDS it is example_interfaces/srv/Trigger");
  locals_.clear();
  local(EndpointKind::publisher, "client", "example_interfaces/srv/Trigger");
  ASSERT_THAT(plan().unbridged, SizeIs(1));
  EXPECT_EQ(plan().unbridged[0].why, WhyNot::unknown_type);
}

}  // namespace
}  // namespace agnocast::bridge
