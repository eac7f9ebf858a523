// SPDX-License-Identifier: Apache-2.0
//
// Goal: messages are printed as `ros2 topic echo` prints them, and no control sequence reaches a
// terminal. Method: messages filled by hand, whole texts compared.

#include <ctl/messages/message_text.hpp>
#include <tests/unit/ctl/made_message.hpp>

#include <gmock/gmock.h>
#include <agnocast_test_msgs/msg/everything.hpp>
#include <agnocast_test_msgs/msg/forest.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/color_rgba.hpp>
#include <std_msgs/msg/empty.hpp>
#include <std_msgs/msg/float64.hpp>
#include <std_msgs/msg/string.hpp>

#include <cmath>
#include <limits>
#include <string>

namespace agnocast::ctl {
namespace {

using test::Made;

std::string yaml(const Value& value, TextOptions options = {}) { return yaml_of(value, options); }
std::string scalar_of(const std::string& text) {
  Made<std_msgs::msg::String> message;
  message->data = text;
  const std::string line = yaml(message.value());
  EXPECT_TRUE(line.starts_with("data: ") && line.ends_with('\n')) << line;
  return line.substr(6, line.size() - 7);
}

sensor_msgs::msg::PointCloud2 cloud() {
  sensor_msgs::msg::PointCloud2 cloud;
  cloud.header.stamp.sec = -3;
  cloud.header.frame_id = "top";
  cloud.fields.resize(2);
  cloud.fields[0].name = "x";
  cloud.fields[1].offset = 4;
  cloud.data = {1, 2, 255};
  return cloud;
}

TEST(MessageText, YamlHasTheShapeOfRos2) {
  const Made<sensor_msgs::msg::PointCloud2> message(cloud());
  EXPECT_EQ(yaml(message.value()),
            "header:\n  stamp:\n    sec: -3\n    nanosec: 0\n  frame_id: top\n"
            "height: 0\nwidth: 0\nfields:\n"
            "- name: x\n  offset: 0\n  datatype: 0\n  count: 0\n"
            "- name: ''\n  offset: 4\n  datatype: 0\n  count: 0\n"
            "is_bigendian: false\npoint_step: 0\nrow_step: 0\ndata:\n- 1\n- 2\n- 255\n"
            "is_dense: false\n");
  EXPECT_EQ(flow_yaml_of(message.value(), {}),
            "{header: {stamp: {sec: -3, nanosec: 0}, frame_id: top}, height: 0, width: 0, fields: "
            "[{name: x, offset: 0, datatype: 0, count: 0}, {name: '', offset: 4, datatype: 0, "
            "count: 0}], is_bigendian: false, point_step: 0, row_step: 0, data: [1, 2, 255], "
            "is_dense: false}");
  EXPECT_EQ(csv_of(message.value(), {}), "-3,0,top,0,0,x,0,0,0,,4,0,0,False,0,0,1,2,255,False");
}

TEST(MessageText, EmptyMessagesAndSequencesAreBracesAndBrackets) {
  EXPECT_EQ(yaml(Made<std_msgs::msg::Empty>().value()), "{}\n");
  Made<agnocast_test_msgs::msg::Forest> forest;
  EXPECT_EQ(yaml(forest.value()), "trees: []\n");
  forest->trees.resize(1);
  EXPECT_EQ(yaml(forest.value()),
            "trees:\n- trunk:\n    leaves: []\n    name: ''\n  boughs:\n"
            "  - leaves: []\n    name: ''\n  - leaves: []\n    name: ''\n");
}

TEST(MessageText, LongArraysAndStringsEndInDots) {
  Made<sensor_msgs::msg::PointCloud2> message(cloud());
  message->header.frame_id = "äöü";
  TextOptions options;
  options.truncate_length = 2;
  const std::string text = yaml(message.value(), options);
  EXPECT_THAT(text, testing::HasSubstr("frame_id: äö...\n")) << "characters, not bytes";
  EXPECT_THAT(text, testing::HasSubstr("data:\n- 1\n- 2\n- '...'\n"));
  EXPECT_THAT(csv_of(message.value(), options), testing::HasSubstr(",1,2,...,False"));
  EXPECT_EQ(json_of(message.value(), options)["data"].dump(), "[1,2,\"...\"]");
  options.truncate_length = 3;
  EXPECT_THAT(yaml(message.value(), options), testing::Not(testing::HasSubstr("...")));
  options.truncate_length = 0;
  EXPECT_THAT(yaml(message.value(), options), testing::HasSubstr("data:\n- '...'\n"));
}

TEST(MessageText, ArraysAndStringsCanBeOmitted) {
  const Made<sensor_msgs::msg::PointCloud2> message(cloud());
  TextOptions options;
  options.no_arrays = options.no_strings = true;
  const std::string text = yaml(message.value(), options);
  EXPECT_THAT(text, testing::HasSubstr(
                        "fields: '<sequence type: sensor_msgs/msg/PointField, length: 2>'\n"));
  EXPECT_THAT(text, testing::HasSubstr("data: '<sequence type: uint8, length: 3>'\n"));
  EXPECT_THAT(text, testing::HasSubstr("frame_id: '<string length: <3>>'\n"));
  Made<agnocast_test_msgs::msg::Everything> everything;
  const std::string all = yaml(everything.value(), options);
  EXPECT_THAT(all, testing::HasSubstr("flags: '<sequence type: boolean, length: 0>'\n"));
  EXPECT_THAT(all, testing::HasSubstr("bounded_numbers: '<sequence type: int32[5], length: 0>'\n"));
  EXPECT_THAT(all, testing::HasSubstr("fixed_numbers: '<array type: uint8[16]>'\n"));
  EXPECT_THAT(all, testing::HasSubstr("numbers: '<sequence type: double, length: 0>'\n"));
}

TEST(MessageText, NumbersAreFormattedAsInPython) {
  using Limits = std::numeric_limits<double>;
  for (const auto& [number, text] : std::initializer_list<std::pair<double, const char*>>{
           {0, "0.0"},
           {-0.0, "-0.0"},
           {1, "1.0"},
           {0.1, "0.1"},
           {1.0 / 3, "0.3333333333333333"},
           {123456789, "123456789.0"},
           {1e15, "1000000000000000.0"},
           {9999999999999998, "9999999999999998.0"},
           {1e16, "1.0e+16"},
           {1.5e300, "1.5e+300"},
           {0.0001, "0.0001"},
           {0.00001, "1.0e-05"},
           {double{0.1f}, "0.10000000149011612"},
           {Limits::denorm_min(), "5.0e-324"},
           {Limits::max(), "1.7976931348623157e+308"},
           {Limits::infinity(), ".inf"},
           {-Limits::infinity(), "-.inf"},
           {Limits::quiet_NaN(), ".nan"}})
    EXPECT_EQ(yaml_number(number), text);
}

TEST(MessageText, StringsAreQuotedWhereYamlNeedsIt) {
  for (const char* const plain : {"hello", "base_link", "a b", "a:b", "/tf", "x-y", "a#b", "é",
                                  "1.2.3 m", "-y", "?x", "a, b", "it's"})
    EXPECT_EQ(scalar_of(plain), plain);
  for (const char* const quoted :
       {"",     " a",  "a ",    "true",     "No",         "on", "null", "~",    "1",     "-1",
        "0x1f", "1e3", "1_000", "12:30:00", "2024-01-01", ".5", "- a",  "? a",  "a: b",  "a:",
        "a #b", "#a",  "[a",    "{a",       "&a",         "*a", "!a",   "|",    ">",     "%a",
        "@a",   "`a",  "---",   "...",      "=",          "<<", ".nan", ".inf", "\"a\"", ",a"})
    EXPECT_EQ(scalar_of(quoted), std::string("'") + quoted + "'");
  EXPECT_EQ(scalar_of("'a'"), "'''a'''");
}

TEST(MessageText, ControlCharactersAreEscaped) {
  EXPECT_EQ(scalar_of("\x1b[2J"), "\"\\e[2J\"");
  EXPECT_EQ(scalar_of(std::string("a\0b", 3)), "\"a\\0b\"");
  EXPECT_EQ(scalar_of("a\r\n\t\"\\"), "\"a\\r\\n\\t\\\"\\\\\"");
  EXPECT_EQ(scalar_of("\x7f"), "\"\\x7f\"");
  EXPECT_EQ(scalar_of("\xc2\x9b"), "\"\\x9b\"") << "CSI as one character";
  EXPECT_EQ(scalar_of("\xe2\x80\xae"), "\"\\u202e\"") << "right-to-left override";
  EXPECT_EQ(scalar_of("\xe2\x80\xa8"), "\"\\u2028\"");
  EXPECT_EQ(scalar_of("\xf3\xa0\x80\x81"), "\"\\U000e0001\"");
  EXPECT_EQ(scalar_of("\xff\xfe"), "!!binary \"//4=\"") << "invalid UTF-8";
  Made<std_msgs::msg::String> message;
  message->data = "a,\"\x1b";
  EXPECT_EQ(csv_of(message.value(), {}), "\"\"\"a,\\\"\"\\e\"\"\"");
  message->data = "say \"hi\", you";
  EXPECT_EQ(csv_of(message.value(), {}), "\"say \"\"hi\"\", you\"");
  EXPECT_EQ(bare_text_of(message.value().field(0), {}), "say \"hi\", you");
  message->data = "\x1b]0;x\x07";
  EXPECT_EQ(bare_text_of(message.value().field(0), {}), "\"\\e]0;x\\a\"");
}

TEST(MessageText, JsonEncodesValuesThatItDoesNotHave) {
  Made<agnocast_test_msgs::msg::Everything> message;
  message->numbers = {std::nan(""), HUGE_VAL, -HUGE_VAL, 0.5};
  message->text = "\xff";
  message->wide = {0xd800};
  message->flags = {true, false};
  const Object object = json_of(message.value(), {});
  EXPECT_EQ(object["numbers"].dump(), R"(["NaN","Infinity","-Infinity",0.5])");
  EXPECT_EQ(object["text"].dump(), R"({"base64":"/w=="})");
  EXPECT_EQ(object["wide"].dump(), R"({"base64":"ANg="})");
  EXPECT_EQ(object["flags"].dump(), "[true,false]");
  EXPECT_EQ(object["nothing"].dump(), "{}");
}

TEST(MessageText, APathFindsItsField) {
  const Made<sensor_msgs::msg::PointCloud2> message(cloud());
  const auto at = [&](const std::string& place) {
    const auto path = Path::parse(place, message.type().members());
    EXPECT_TRUE(path) << place;
    const auto value = path->in(message.value());
    return value ? yaml(*value) : std::string("(not there)");
  };
  EXPECT_EQ(at("header.stamp"), "sec: -3\nnanosec: 0\n");
  EXPECT_EQ(at("header.frame_id"), "top\n");
  EXPECT_EQ(at("fields[1].offset"), "4\n");
  EXPECT_EQ(at("fields[2].offset"), "(not there)");
  EXPECT_EQ(at("data"), "- 1\n- 2\n- 255\n");
  EXPECT_EQ(at("data[2]"), "255\n");
  EXPECT_EQ(at("data[3]"), "(not there)");
  for (const auto& [place, why] : std::initializer_list<std::pair<const char*, const char*>>{
           {"", "a name is missing"},
           {".header", "a name is missing"},
           {"header.", "a name is missing"},
           {"header..stamp", "a name is missing"},
           {"heador",
            "sensor_msgs/msg/PointCloud2 has no field \"heador\"; it has: header, height, "
            "width, fields, is_bigendian, point_step, row_step, data, is_dense"},
           {"height.x", "uint32 has no field \"x\""},
           {"height[0]", "uint32 has no elements"},
           {"fields.name", "sensor_msgs/msg/PointField[] has no field \"name\""},
           {"fields[x]", "'[' needs an index and ']'"},
           {"fields[-1]", "'[' needs an index and ']'"},
           {"fields[1", "'[' needs an index and ']'"},
           {"fields[99999999999999999999]", "'[' needs an index and ']'"},
           {"fields[1]name", "a '.' or '[' is missing"}}) {
    const auto path = Path::parse(place, message.type().members());
    ASSERT_FALSE(path) << place;
    EXPECT_EQ(path.error().why, why);
    EXPECT_EQ(path.error().status, Status::wrong_usage);
  }
  const auto outside = Path::parse("fixed_numbers[16]",
                                   find_message_type("agnocast_test_msgs/Everything").members());
  ASSERT_FALSE(outside);
  EXPECT_EQ(outside.error().why, "element 16 is not in uint8[16]");
}

TEST(MessageText, BytesAreHexadecimal) {
  std::string bytes(33, '\xab');
  EXPECT_EQ(hexadecimal_bytes(bytes.data(), 33, {}),
            "abababababababababababababababababababababababababababababababab\nab\n");
  TextOptions options;
  options.truncate_length = 1;
  EXPECT_EQ(hexadecimal_bytes(bytes.data(), 33, options), "ab\n...\n");
  EXPECT_EQ(hexadecimal_bytes(bytes.data(), 0, options), "");
}

}  // namespace
}  // namespace agnocast::ctl
