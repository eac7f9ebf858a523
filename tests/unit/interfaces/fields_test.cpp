// SPDX-License-Identifier: Apache-2.0
//
// Goal: our messages have the fields of ROS 2 Humble, in its order; otherwise bytes from a ROS 2
// machine would be misread without any error. Method: find every message by its name, walk the
// introspection tables of the generated code, write every field as text, and compare with
// expected_fields.hpp. If AGNOCAST_GOLDEN_CDR_DIR names a folder of samples recorded from ROS 2,
// also compare with their schemas.

#include <agnocast/generic.hpp>
#include <every_message_name.hpp>
#include <tests/unit/interfaces/expected_fields.hpp>

#include <gtest/gtest.h>
#include <geometry_msgs/msg/quaternion.hpp>
#include <nlohmann/json.hpp>
#include <rosidl_typesupport_introspection_cpp/field_types.hpp>
#include <rosidl_typesupport_introspection_cpp/message_introspection.hpp>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <string>
#include <string_view>

namespace agnocast {
namespace {

namespace introspection = rosidl_typesupport_introspection_cpp;

// Returns the table of the generated code.

const MessageMembers& members_of(const rosidl_message_type_support_t* handle) {
  return *static_cast<const MessageMembers*>(handle->data);
}

// "sensor_msgs::msg" and "Image" become "sensor_msgs/msg/Image".
std::string ros_name_of(const MessageMembers& message) {
  std::string name = message.message_namespace_;
  for (std::size_t at = name.find("::"); at != std::string::npos; at = name.find("::")) {
    name.replace(at, 2, "/");
  }
  return name + "/" + message.message_name_;
}

std::string element_type_of(const MessageMember& field) {
  const auto bounded = [&](std::string text) {
    const std::size_t bound = field.string_upper_bound_;
    return bound == 0 ? text : text + "<=" + std::to_string(bound);
  };
  switch (field.type_id_) {
    case introspection::ROS_TYPE_BOOLEAN:
      return "bool";
    case introspection::ROS_TYPE_OCTET:
      return "byte";
    case introspection::ROS_TYPE_CHAR:
      return "char";
    case introspection::ROS_TYPE_WCHAR:
      return "wchar";
    case introspection::ROS_TYPE_FLOAT:
      return "float32";
    case introspection::ROS_TYPE_DOUBLE:
      return "float64";
    case introspection::ROS_TYPE_LONG_DOUBLE:
      return "float128";
    case introspection::ROS_TYPE_INT8:
      return "int8";
    case introspection::ROS_TYPE_UINT8:
      return "uint8";
    case introspection::ROS_TYPE_INT16:
      return "int16";
    case introspection::ROS_TYPE_UINT16:
      return "uint16";
    case introspection::ROS_TYPE_INT32:
      return "int32";
    case introspection::ROS_TYPE_UINT32:
      return "uint32";
    case introspection::ROS_TYPE_INT64:
      return "int64";
    case introspection::ROS_TYPE_UINT64:
      return "uint64";
    case introspection::ROS_TYPE_STRING:
      return bounded("string");
    case introspection::ROS_TYPE_WSTRING:
      return bounded("wstring");
    case introspection::ROS_TYPE_MESSAGE:
      return ros_name_of(members_of(field.members_));
    default:
      return "type " + std::to_string(field.type_id_);
  }
}

// T, T[n] for an array, T[<=n] for a bounded and T[] for an unbounded sequence.
std::string type_of(const MessageMember& field) {
  const std::string element = element_type_of(field);
  if (!field.is_array_) return element;
  if (field.array_size_ == 0) return element + "[]";
  return element + (field.is_upper_bound_ ? "[<=" : "[") + std::to_string(field.array_size_) + "]";
}

void append_field(std::string& text, std::string_view type, std::string_view name) {
  if (!text.empty()) text += ", ";
  text.append(type).append(" ").append(name);
}

std::string fields_of(const MessageMembers& message) {
  std::string text;
  for (std::uint32_t index = 0; index < message.member_count_; ++index) {
    const MessageMember& field = message.members_[index];
    append_field(text, type_of(field), field.name_);
  }
  return text;
}

TEST(InterfaceFields, MatchRos2Humble) {
  for (const auto& [name, fields] : test::expected_fields) {
    const auto type = try_find_message_type(name);
    ASSERT_TRUE(type) << text_of(type.error());
    EXPECT_EQ(ros_name_of(type->members()), name);
    EXPECT_EQ(fields_of(type->members()), fields) << name;
  }
}

TEST(InterfaceFields, CoverEveryMessage) {
  std::set<std::string> expected;
  for (const auto& [name, fields] : test::expected_fields)
    EXPECT_TRUE(expected.insert(name).second) << name << " is listed twice";
  for (const std::string name : test::every_message_name) {
    if (name.rfind("agnocast_test_msgs/", 0) == 0) continue;
    EXPECT_EQ(expected.count(name), 1U) << name;
  }
}

TEST(InterfaceFields, OfANestedMessageComeFromItsOwnTable) {
  // The tables reach a nested message through their own pointer.
  for (const char* const name : test::every_message_name) {
    const IntrospectedType type = find_message_type(name);
    for (std::uint32_t index = 0; index < type.members().member_count_; ++index) {
      const MessageMember& field = type.members().members_[index];
      if (field.type_id_ != introspection::ROS_TYPE_MESSAGE) continue;
      const MessageMembers& nested = members_of(field.members_);
      EXPECT_EQ(&nested, &find_message_type(ros_name_of(nested)).members())
          << name << "." << field.name_;
    }
  }
}

TEST(InterfaceDefaults, QuaternionIsTheIdentity) {
  const geometry_msgs::msg::Quaternion rotation;
  EXPECT_EQ(rotation.x, 0.0);
  EXPECT_EQ(rotation.y, 0.0);
  EXPECT_EQ(rotation.z, 0.0);
  EXPECT_EQ(rotation.w, 1.0);
}

TEST(InterfaceFields, MatchTheSchemasOfRecordedSamples) {
  const char* const folder = std::getenv("AGNOCAST_GOLDEN_CDR_DIR");
  if (folder == nullptr) GTEST_SKIP() << "AGNOCAST_GOLDEN_CDR_DIR names no folder of samples";

  std::set<std::string> compared;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() != ".json") continue;
    const auto sample = nlohmann::json::parse(std::ifstream(entry.path()));
    if (!sample.contains("schema")) continue;
    for (const auto& [name, fields] : sample.at("schema").items()) {
      SCOPED_TRACE(entry.path().filename().string() + ": " + name);
      const auto type = try_find_message_type(name);
      ASSERT_TRUE(type) << text_of(type.error());
      std::string recorded;
      for (const auto& field : fields)
        append_field(recorded, field.at(1).get<std::string>(), field.at(0).get<std::string>());
      EXPECT_EQ(fields_of(type->members()), recorded);
      compared.insert(name);
    }
  }
  EXPECT_GE(compared.size(), 40U) << "too few schemas in " << folder;
}

}  // namespace
}  // namespace agnocast
