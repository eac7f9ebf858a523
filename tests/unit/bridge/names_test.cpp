// SPDX-License-Identifier: Apache-2.0
//
// Goal: ROS names map to DDS names and back, and no other name maps.

#include <bridge/dds/names.hpp>

#include <gtest/gtest.h>

namespace agnocast::bridge {
namespace {

TEST(DdsNames, TopicsAndServicesMapToDdsAndBack) {
  const std::pair<RosTopic, const char*> pairs[] = {
      {{DdsTopicKind::topic, "/chatter"}, "rt/chatter"},
      {{DdsTopicKind::topic, "/a/b_2/_c"}, "rt/a/b_2/_c"},
      {{DdsTopicKind::request, "/add_two_ints"}, "rq/add_two_intsRequest"},
      {{DdsTopicKind::reply, "/add_two_ints"}, "rr/add_two_intsReply"},
      {{DdsTopicKind::request, "/Request"}, "rq/RequestRequest"},
      {{DdsTopicKind::topic, "/fib/_action/feedback"}, "rt/fib/_action/feedback"},
      {{DdsTopicKind::reply, "/fib/_action/send_goal"}, "rr/fib/_action/send_goalReply"},
  };
  for (const auto& [ros, dds] : pairs) {
    EXPECT_EQ(dds_topic_of(ros), dds);
    EXPECT_EQ(ros_topic_of(dds), ros);
  }
}

TEST(DdsNames, OtherDdsTopicsAreNoRosTopics) {
  for (const char* const name : {"",
                                 "rt",
                                 "rt/",
                                 "rt//a",
                                 "rt/a/",
                                 "rt/a//b",
                                 "rt/2a",
                                 "rt/a b",
                                 "rt/a-b",
                                 "/rt/a",
                                 "rt_a",
                                 "rta",
                                 "ros_discovery_info",
                                 "DCPSParticipant",
                                 "rq/a",
                                 "rq/Request",
                                 "rqRequest",
                                 "rq/aReply",
                                 "rr/aRequest",
                                 "rr/Reply",
                                 "rrReply",
                                 "rs/a",
                                 "Request",
                                 "rt/\xc3\xa4"})
    EXPECT_FALSE(ros_topic_of(name)) << name;
  EXPECT_FALSE(ros_topic_of(std::string_view("rt/a\0b", 6)));
}

TEST(DdsNames, NamesThatAreNotFullyQualifiedDoNotMap) {
  for (const char* const name : {"", "/", "a", "a/b", "/a/", "//a", "/1", "~/a", "/{node}", "/a b"})
    EXPECT_FALSE(dds_topic_of({DdsTopicKind::topic, name})) << name;
  EXPECT_TRUE(dds_topic_of({DdsTopicKind::topic, "/" + std::string(254, 'a')}));
  EXPECT_FALSE(dds_topic_of({DdsTopicKind::topic, "/" + std::string(255, 'a')}));
  EXPECT_FALSE(ros_topic_of("rt/" + std::string(255, 'a')));
}

TEST(DdsNames, TypesMapToDdsAndBack) {
  const std::pair<const char*, const char*> pairs[] = {
      {"std_msgs/msg/String", "std_msgs::msg::dds_::String_"},
      {"p2/msg/UInt8MultiArray", "p2::msg::dds_::UInt8MultiArray_"},
      {"std_srvs/srv/Empty_Request", "std_srvs::srv::dds_::Empty_Request_"},
      {"std_srvs/srv/Empty_Response", "std_srvs::srv::dds_::Empty_Response_"},
      {"std_srvs/srv/Empty_Event", "std_srvs::srv::dds_::Empty_Event_"},
      {"p/action/Fib_Goal", "p::action::dds_::Fib_Goal_"},
      {"p/action/Fib_Result", "p::action::dds_::Fib_Result_"},
      {"p/action/Fib_Feedback", "p::action::dds_::Fib_Feedback_"},
      {"p/action/Fib_FeedbackMessage", "p::action::dds_::Fib_FeedbackMessage_"},
      {"p/action/Fib_SendGoal_Request", "p::action::dds_::Fib_SendGoal_Request_"},
      {"p/action/Fib_GetResult_Response", "p::action::dds_::Fib_GetResult_Response_"},
  };
  for (const auto& [ros, dds] : pairs) {
    EXPECT_EQ(dds_type_of(ros), dds);
    EXPECT_EQ(ros_type_of(dds), ros);
  }
}

TEST(DdsNames, OtherTypesDoNotMap) {
  for (const char* const name : {"",
                                 "std_msgs",
                                 "std_msgs/String",
                                 "std_msgs/msg",
                                 "std_msgs/msg/",
                                 "std_msgs/msg/string",
                                 "Std/msg/String",
                                 "/msg/String",
                                 "std_msgs/msg/a/B",
                                 "std_msgs/msg/A/B",
                                 "p/srv/Empty",
                                 "p/srv/_Request",
                                 "p/srv/Empty_Reply",
                                 "p/action/Fib",
                                 "p/action/Fib_Request",
                                 "p/msg/Empty_Request",
                                 "p/idl/Name",
                                 "p//Name",
                                 "p/msg/Na me",
                                 "p/msg/Name_"})
    EXPECT_FALSE(dds_type_of(name)) << name;
  for (const char* const name :
       {"", "std_msgs::msg::dds_::String", "std_msgs::msg::String_", "std_msgs::dds_::String_",
        "std_msgs::msg::dds_::", "std_msgs::msg::dds_::_", "std_msgs::msg::dds_::string_",
        "::msg::dds_::String_", "std_msgs::msg::dds_::a::B_", "a::std_msgs::msg::dds_::String_",
        "std_msgs::msg::dds_String_", "p::srv::dds_::Empty_", "DDS::String"})
    EXPECT_FALSE(ros_type_of(name)) << name;
}

}  // namespace
}  // namespace agnocast::bridge
