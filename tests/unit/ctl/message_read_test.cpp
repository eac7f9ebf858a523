// SPDX-License-Identifier: Apache-2.0
//
// Goal: a printed message is read back as the same message, for every type; other text is refused
// with the place of the error. Method: random messages of every type of interfaces/, made from the
// type's table; texts written by hand.

#include <ctl/messages/message_read.hpp>
#include <ctl/messages/message_text.hpp>
#include <every_message_name.hpp>
#include <tests/support/messages/random_message.hpp>
#include <tests/unit/ctl/made_message.hpp>

#include <gmock/gmock.h>
#include <agnocast_test_msgs/msg/everything.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/byte_multi_array.hpp>

#include <string>

namespace agnocast::ctl {
namespace {

void expect_same(const std::string& text, const IntrospectedType& type, const void* message,
                 const std::string& name) {
  const auto read = read_messages(text, type);
  ASSERT_TRUE(read) << name << ": " << read.error().what << ": " << read.error().why << '\n'
                    << text;
  ASSERT_EQ(read->size(), 1U);
  std::string where;
  EXPECT_TRUE(test::are_same(type.members(), read->front().message.get(), message, &where))
      << name << " differs at " << where << '\n'
      << text;
}

TEST(MessageRead, EveryPrintedMessageIsReadBack) {
  test::RandomMessages random(31, {.has_nan = true, .has_any_text = true});
  for (const char* const name : test::every_message_name) {
    const IntrospectedType type = find_message_type(name);
    for (int round = 0; round < 25 && !HasFailure(); ++round) {
      const OwnedGenericMessage message = type.make();
      random.fill(type.members(), message.get());
      const Value value = Value::of(type.members(), message.get());
      expect_same(yaml_of(value, {}), type, message.get(), name);
      expect_same(yaml_of(value, {}) + "---\n", type, message.get(), name);
      expect_same(flow_yaml_of(value, {}), type, message.get(), name);
    }
  }
}

TEST(MessageRead, OmittedFieldsHaveTheirDefaults) {
  for (const char* const name : test::every_message_name) {
    const IntrospectedType type = find_message_type(name);
    expect_same("{}", type, type.make().get(), name);
  }
}

TEST(MessageRead, JsonIsRead) {
  using sensor_msgs::msg::PointCloud2;
  const auto read = read_messages(
      R"({"header": {"frame_id": "a\u00e4\ud83d\ude00"}, "data": [1, 2], "is_dense": true})",
      test::Made<PointCloud2>::type());
  // YAML has no pairs of \u for one character; the rest of JSON is YAML.
  EXPECT_FALSE(read);
  const auto plain = read_messages(R"({"header": {"frame_id": "ab"}, "data": [1, 2]})",
                                   test::Made<PointCloud2>::type());
  ASSERT_TRUE(plain);
  const auto& cloud = *reinterpret_cast<const PointCloud2*>(plain->front().message.get());
  EXPECT_EQ(cloud.header.frame_id, "ab");
  EXPECT_EQ(cloud.data, (std::vector<std::uint8_t>{1, 2}));
}

TEST(MessageRead, DocumentsAreMessages) {
  const auto read = read_messages("height: 1\n---\nheight: 2\n---\n",
                                  test::Made<sensor_msgs::msg::PointCloud2>::type());
  ASSERT_TRUE(read);
  ASSERT_EQ(read->size(), 2U);
  EXPECT_EQ(
      reinterpret_cast<const sensor_msgs::msg::PointCloud2*>((*read)[1].message.get())->height, 2U);
}

TEST(MessageRead, AutoAndNowAreTheTimeOfPublishing) {
  const auto type = test::Made<sensor_msgs::msg::PointCloud2>::type();
  for (const char* const text : {"header: auto", "header: {stamp: now, frame_id: a}"}) {
    const auto read = read_messages(text, type);
    ASSERT_TRUE(read) << read.error().why;
    read->front().set_times(1'700'000'000'123'456'789);
    const auto& cloud =
        *reinterpret_cast<const sensor_msgs::msg::PointCloud2*>(read->front().message.get());
    EXPECT_EQ(cloud.header.stamp.sec, 1'700'000'000);
    EXPECT_EQ(cloud.header.stamp.nanosec, 123'456'789U);
  }
  const auto quoted = read_messages("header: 'auto'", type);
  ASSERT_FALSE(quoted);
}

TEST(MessageRead, NumbersAreReadInAllForms) {
  using agnocast_test_msgs::msg::Everything;
  const auto read = read_messages(
      "{bounded_numbers: [0x10, -0x10, 0o17, 0b11, +5], numbers: [1, .5, 1., -.inf, .NaN, 1E3, "
      "-0]}",
      test::Made<Everything>::type());
  ASSERT_TRUE(read) << read.error().why;
  const auto& message = *reinterpret_cast<const Everything*>(read->front().message.get());
  EXPECT_THAT(std::vector<int>(message.bounded_numbers.begin(), message.bounded_numbers.end()),
              testing::ElementsAre(16, -16, 15, 3, 5));
  EXPECT_EQ(message.numbers[0], 1);
  EXPECT_EQ(message.numbers[1], 0.5);
  EXPECT_EQ(message.numbers[3], -HUGE_VAL);
  EXPECT_TRUE(std::isnan(message.numbers[4]));
  EXPECT_EQ(message.numbers[5], 1000);
}

// Long because it is the table of bad texts.
TEST(MessageRead, OtherTextIsRefusedWithThePlaceOfTheError) {
  struct Case {
    const char* text;
    const char* what;
    const char* why;
  };
  const auto everything = test::Made<agnocast_test_msgs::msg::Everything>::type();
  for (const Case& one : {
           Case{"fixed_numbers: [1]", "fixed_numbers", "1 elements do not fit uint8[16]"},
           Case{"bounded_numbers: [1,2,3,4,5,6]", "bounded_numbers",
                "6 elements do not fit int32[<=5]"},
           Case{"bounded_numbers: [1, x]", "bounded_numbers[1]", "'x' is not of type int32"},
           Case{"bounded_numbers: ['1']", "bounded_numbers[0]", "'1' is not of type int32"},
           Case{"bounded_numbers: [1.5]", "bounded_numbers[0]", "'1.5' is not of type int32"},
           Case{"bounded_numbers: [2147483648]", "bounded_numbers[0]",
                "'2147483648' is out of the range of int32"},
           Case{"bounded_numbers: [-2147483649]", "bounded_numbers[0]",
                "'-2147483649' is out of the range of int32"},
           Case{"bounded_numbers: [99999999999999999999]", "bounded_numbers[0]",
                "'99999999999999999999' is out of the range of int32"},
           Case{"bounded_numbers: 1", "bounded_numbers", "'1' is not of type int32[<=5]"},
           Case{"bounded_numbers: {a: 1}", "bounded_numbers",
                "a mapping is not of type int32[<=5]"},
           Case{"numbers: [x]", "numbers[0]", "'x' is not of type float64"},
           Case{"numbers: [1e999]", "numbers[0]", "'1e999' is out of the range of float64"},
           Case{"numbers: [infinity]", "numbers[0]", "'infinity' is not of type float64"},
           Case{"numbers: [--1]", "numbers[0]", "'--1' is not of type float64"},
           Case{"fixed_flats: [{x: 1e39}, {}]", "fixed_flats[0].x",
                "'1e39' is out of the range of float32"},
           Case{"flats: [{}, {tag: [0, 1, 256]}]", "flats[1].tag[2]",
                "'256' is out of the range of uint8"},
           Case{"flats: [{}, {tag: [0, 1, -1]}]", "flats[1].tag[2]",
                "'-1' is out of the range of uint8"},
           Case{"flags: [maybe]", "flags[0]", "'maybe' is not of type bool"},
           Case{"flags: [1]", "flags[0]", "'1' is not of type bool"},
           Case{"flags: ['true']", "flags[0]", "'true' is not of type bool"},
           Case{"text: [a]", "text", "a list is not of type string"},
           Case{"text:", "text", "nothing is not of type string"},
           Case{"text: !!binary '!'", "text", "'!' is not valid base64"},
           Case{"bounded_text: 'aaaaaaaaaabbbbbbbbbbccccccccccddddddddddx'", "bounded_text",
                "41 characters do not fit string<=40"},
           Case{"texts_of_bounded: ['', 'aaaaaaaaaabbbbbbbbbbccccccccccddddddddddx']",
                "texts_of_bounded[1]", "41 characters do not fit string<=40"},
           Case{"wide: !!binary 'AA=='", "wide", "an odd number of bytes cannot be a wstring"},
           Case{"inner: 3", "inner", "'3' is not of type agnocast_test_msgs/msg/Inner"},
           Case{"inner: {lable: 3}", "inner",
                "agnocast_test_msgs/msg/Inner has no field 'lable'; it has: label, notes, blob, "
                "wide, "
                "flags"},
           Case{"inner: {label: a, label: b}", "inner", "field 'label' occurs twice"},
           Case{"inner: {[a]: b}", "inner", "agnocast_test_msgs/msg/Inner has no such field"},
           Case{"nothing: {structure_needs_at_least_one_member: 1}", "nothing",
                "agnocast_test_msgs/msg/Empty has no field 'structure_needs_at_least_one_member'; "
                "it "
                "has: none"},
           Case{"[1, 2]", "agnocast_test_msgs/msg/Everything",
                "a list is not of type agnocast_test_msgs/msg/Everything"},
           Case{"\"\\e[2J\"", "agnocast_test_msgs/msg/Everything",
                "'\\x1b[2J' is not of type agnocast_test_msgs/msg/Everything"},
           Case{"", "YAML", "there is no message in it"},
           Case{"---\n---\n", "YAML", "there is no message in it"},
       }) {
    const auto read = read_messages(one.text, everything);
    ASSERT_FALSE(read) << one.text;
    EXPECT_EQ(read.error().what, one.what) << one.text;
    EXPECT_EQ(read.error().why, one.why) << one.text;
    EXPECT_EQ(read.error().status, Status::failed);
  }
  for (const std::string& broken :
       {std::string("{a: "), std::string("a: b: c"), std::string("*nobody"), std::string("\t- x"),
        std::string(100000, '['), std::string("text: \"\\q\"")}) {
    const auto read = read_messages(broken, everything);
    ASSERT_FALSE(read) << broken.substr(0, 20);
    EXPECT_EQ(read.error().what, "YAML") << broken.substr(0, 20);
    EXPECT_THAT(read.error().why, testing::StartsWith("line 1, column "));
  }
}

}  // namespace
}  // namespace agnocast::ctl
