// SPDX-License-Identifier: Apache-2.0
//
// Goal: our messages have the fields of ROS 2 Humble, in its order; otherwise bytes from a ROS 2
// machine would be misread without any error. Method: walk the introspection tables of the
// generated code, write every field as text, and compare with the text below. Constants are
// compared when this file is compiled. With AGNOCAST_GOLDEN_CDR_DIR set to a folder of samples
// recorded from ROS 2, compare with the schemas in them too.
//
// Constants and defaults are not on the wire, but programs rely on them. Later releases of ROS 2
// have more constants; this test asks for those of Humble and therefore holds there too.

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include <builtin_interfaces/msg/duration.hpp>
#include <builtin_interfaces/msg/time.hpp>
#include <geometry_msgs/msg/accel.hpp>
#include <geometry_msgs/msg/accel_stamped.hpp>
#include <geometry_msgs/msg/accel_with_covariance.hpp>
#include <geometry_msgs/msg/accel_with_covariance_stamped.hpp>
#include <geometry_msgs/msg/inertia.hpp>
#include <geometry_msgs/msg/inertia_stamped.hpp>
#include <geometry_msgs/msg/point.hpp>
#include <geometry_msgs/msg/point32.hpp>
#include <geometry_msgs/msg/point_stamped.hpp>
#include <geometry_msgs/msg/polygon.hpp>
#include <geometry_msgs/msg/polygon_stamped.hpp>
#include <geometry_msgs/msg/pose.hpp>
#include <geometry_msgs/msg/pose2_d.hpp>
#include <geometry_msgs/msg/pose_array.hpp>
#include <geometry_msgs/msg/pose_stamped.hpp>
#include <geometry_msgs/msg/pose_with_covariance.hpp>
#include <geometry_msgs/msg/pose_with_covariance_stamped.hpp>
#include <geometry_msgs/msg/quaternion.hpp>
#include <geometry_msgs/msg/quaternion_stamped.hpp>
#include <geometry_msgs/msg/transform.hpp>
#include <geometry_msgs/msg/transform_stamped.hpp>
#include <geometry_msgs/msg/twist.hpp>
#include <geometry_msgs/msg/twist_stamped.hpp>
#include <geometry_msgs/msg/twist_with_covariance.hpp>
#include <geometry_msgs/msg/twist_with_covariance_stamped.hpp>
#include <geometry_msgs/msg/vector3.hpp>
#include <geometry_msgs/msg/vector3_stamped.hpp>
#include <geometry_msgs/msg/velocity_stamped.hpp>
#include <geometry_msgs/msg/wrench.hpp>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <sensor_msgs/msg/battery_state.hpp>
#include <sensor_msgs/msg/camera_info.hpp>
#include <sensor_msgs/msg/channel_float32.hpp>
#include <sensor_msgs/msg/compressed_image.hpp>
#include <sensor_msgs/msg/fluid_pressure.hpp>
#include <sensor_msgs/msg/illuminance.hpp>
#include <sensor_msgs/msg/image.hpp>
#include <sensor_msgs/msg/imu.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <sensor_msgs/msg/joy.hpp>
#include <sensor_msgs/msg/joy_feedback.hpp>
#include <sensor_msgs/msg/joy_feedback_array.hpp>
#include <sensor_msgs/msg/laser_echo.hpp>
#include <sensor_msgs/msg/laser_scan.hpp>
#include <sensor_msgs/msg/magnetic_field.hpp>
#include <sensor_msgs/msg/multi_dof_joint_state.hpp>
#include <sensor_msgs/msg/multi_echo_laser_scan.hpp>
#include <sensor_msgs/msg/nav_sat_fix.hpp>
#include <sensor_msgs/msg/nav_sat_status.hpp>
#include <sensor_msgs/msg/point_cloud.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <sensor_msgs/msg/point_field.hpp>
#include <sensor_msgs/msg/range.hpp>
#include <sensor_msgs/msg/region_of_interest.hpp>
#include <sensor_msgs/msg/relative_humidity.hpp>
#include <sensor_msgs/msg/temperature.hpp>
#include <sensor_msgs/msg/time_reference.hpp>
#include <sensor_msgs/srv/set_camera_info.hpp>
#include <std_msgs/msg/bool.hpp>
#include <std_msgs/msg/byte.hpp>
#include <std_msgs/msg/byte_multi_array.hpp>
#include <std_msgs/msg/char.hpp>
#include <std_msgs/msg/color_rgba.hpp>
#include <std_msgs/msg/empty.hpp>
#include <std_msgs/msg/float32.hpp>
#include <std_msgs/msg/float32_multi_array.hpp>
#include <std_msgs/msg/float64.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>
#include <std_msgs/msg/header.hpp>
#include <std_msgs/msg/int16.hpp>
#include <std_msgs/msg/int16_multi_array.hpp>
#include <std_msgs/msg/int32.hpp>
#include <std_msgs/msg/int32_multi_array.hpp>
#include <std_msgs/msg/int64.hpp>
#include <std_msgs/msg/int64_multi_array.hpp>
#include <std_msgs/msg/int8.hpp>
#include <std_msgs/msg/int8_multi_array.hpp>
#include <std_msgs/msg/multi_array_dimension.hpp>
#include <std_msgs/msg/multi_array_layout.hpp>
#include <std_msgs/msg/string.hpp>
#include <std_msgs/msg/u_int16.hpp>
#include <std_msgs/msg/u_int16_multi_array.hpp>
#include <std_msgs/msg/u_int32.hpp>
#include <std_msgs/msg/u_int32_multi_array.hpp>
#include <std_msgs/msg/u_int64.hpp>
#include <std_msgs/msg/u_int64_multi_array.hpp>
#include <std_msgs/msg/u_int8.hpp>
#include <std_msgs/msg/u_int8_multi_array.hpp>

#include <nlohmann/json.hpp>
#include <rosidl_typesupport_introspection_cpp/field_types.hpp>
#include <rosidl_typesupport_introspection_cpp/message_introspection.hpp>
#include <rosidl_typesupport_introspection_cpp/message_type_support_decl.hpp>

namespace agnocast {
namespace {

namespace introspection = rosidl_typesupport_introspection_cpp;

// Constants.

using sensor_msgs::msg::BatteryState;
static_assert(BatteryState::POWER_SUPPLY_STATUS_UNKNOWN == 0);
static_assert(BatteryState::POWER_SUPPLY_STATUS_CHARGING == 1);
static_assert(BatteryState::POWER_SUPPLY_STATUS_DISCHARGING == 2);
static_assert(BatteryState::POWER_SUPPLY_STATUS_NOT_CHARGING == 3);
static_assert(BatteryState::POWER_SUPPLY_STATUS_FULL == 4);
static_assert(BatteryState::POWER_SUPPLY_HEALTH_UNKNOWN == 0);
static_assert(BatteryState::POWER_SUPPLY_HEALTH_GOOD == 1);
static_assert(BatteryState::POWER_SUPPLY_HEALTH_OVERHEAT == 2);
static_assert(BatteryState::POWER_SUPPLY_HEALTH_DEAD == 3);
static_assert(BatteryState::POWER_SUPPLY_HEALTH_OVERVOLTAGE == 4);
static_assert(BatteryState::POWER_SUPPLY_HEALTH_UNSPEC_FAILURE == 5);
static_assert(BatteryState::POWER_SUPPLY_HEALTH_COLD == 6);
static_assert(BatteryState::POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE == 7);
static_assert(BatteryState::POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE == 8);
static_assert(BatteryState::POWER_SUPPLY_TECHNOLOGY_UNKNOWN == 0);
static_assert(BatteryState::POWER_SUPPLY_TECHNOLOGY_NIMH == 1);
static_assert(BatteryState::POWER_SUPPLY_TECHNOLOGY_LION == 2);
static_assert(BatteryState::POWER_SUPPLY_TECHNOLOGY_LIPO == 3);
static_assert(BatteryState::POWER_SUPPLY_TECHNOLOGY_LIFE == 4);
static_assert(BatteryState::POWER_SUPPLY_TECHNOLOGY_NICD == 5);
static_assert(BatteryState::POWER_SUPPLY_TECHNOLOGY_LIMN == 6);

using sensor_msgs::msg::JoyFeedback;
static_assert(JoyFeedback::TYPE_LED == 0);
static_assert(JoyFeedback::TYPE_RUMBLE == 1);
static_assert(JoyFeedback::TYPE_BUZZER == 2);

using sensor_msgs::msg::NavSatFix;
static_assert(NavSatFix::COVARIANCE_TYPE_UNKNOWN == 0);
static_assert(NavSatFix::COVARIANCE_TYPE_APPROXIMATED == 1);
static_assert(NavSatFix::COVARIANCE_TYPE_DIAGONAL_KNOWN == 2);
static_assert(NavSatFix::COVARIANCE_TYPE_KNOWN == 3);

using sensor_msgs::msg::NavSatStatus;
static_assert(NavSatStatus::STATUS_NO_FIX == -1);
static_assert(NavSatStatus::STATUS_FIX == 0);
static_assert(NavSatStatus::STATUS_SBAS_FIX == 1);
static_assert(NavSatStatus::STATUS_GBAS_FIX == 2);
static_assert(NavSatStatus::SERVICE_GPS == 1);
static_assert(NavSatStatus::SERVICE_GLONASS == 2);
static_assert(NavSatStatus::SERVICE_COMPASS == 4);
static_assert(NavSatStatus::SERVICE_GALILEO == 8);

using sensor_msgs::msg::PointField;
static_assert(PointField::INT8 == 1);
static_assert(PointField::UINT8 == 2);
static_assert(PointField::INT16 == 3);
static_assert(PointField::UINT16 == 4);
static_assert(PointField::INT32 == 5);
static_assert(PointField::UINT32 == 6);
static_assert(PointField::FLOAT32 == 7);
static_assert(PointField::FLOAT64 == 8);

using sensor_msgs::msg::Range;
static_assert(Range::ULTRASOUND == 0);
static_assert(Range::INFRARED == 1);

// What the generated code says.

const introspection::MessageMembers& members_of(const rosidl_message_type_support_t* handle) {
  return *static_cast<const introspection::MessageMembers*>(handle->data);
}

// "sensor_msgs::msg" and "Image" become "sensor_msgs/msg/Image".
std::string ros_name_of(const introspection::MessageMembers& message) {
  std::string name = message.message_namespace_;
  for (std::size_t at = name.find("::"); at != std::string::npos; at = name.find("::")) {
    name.replace(at, 2, "/");
  }
  return name + "/" + message.message_name_;
}

std::string element_type_of(const introspection::MessageMember& field) {
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
std::string type_of(const introspection::MessageMember& field) {
  const std::string element = element_type_of(field);
  if (!field.is_array_) return element;
  if (field.array_size_ == 0) return element + "[]";
  return element + (field.is_upper_bound_ ? "[<=" : "[") + std::to_string(field.array_size_) + "]";
}

void append_field(std::string& text, std::string_view type, std::string_view name) {
  if (!text.empty()) text += ", ";
  text.append(type).append(" ").append(name);
}

std::string fields_of(const introspection::MessageMembers& message) {
  std::string text;
  for (std::uint32_t index = 0; index < message.member_count_; ++index) {
    const introspection::MessageMember& field = message.members_[index];
    append_field(text, type_of(field), field.name_);
  }
  return text;
}

// What we expect.

struct Row {
  std::string name;
  std::string fields;
  const introspection::MessageMembers* message;
};

template <typename Message>
Row row(const char* name, const char* fields) {
  return {name, fields, &members_of(introspection::get_message_type_support_handle<Message>())};
}

// Every message of the four packages. A message without fields gets a hidden one from the
// generator, and it is on the wire. A field declared char is a uint8.
const std::vector<Row>& table() {
  static const std::vector<Row> rows = {
      row<builtin_interfaces::msg::Duration>("builtin_interfaces/msg/Duration",
                                             "int32 sec, uint32 nanosec"),
      row<builtin_interfaces::msg::Time>("builtin_interfaces/msg/Time",
                                         "int32 sec, uint32 nanosec"),
      row<std_msgs::msg::Bool>("std_msgs/msg/Bool", "bool data"),
      row<std_msgs::msg::Byte>("std_msgs/msg/Byte", "byte data"),
      row<std_msgs::msg::ByteMultiArray>("std_msgs/msg/ByteMultiArray",
                                         "std_msgs/msg/MultiArrayLayout layout, byte[] data"),
      row<std_msgs::msg::Char>("std_msgs/msg/Char", "uint8 data"),
      row<std_msgs::msg::ColorRGBA>("std_msgs/msg/ColorRGBA",
                                    "float32 r, float32 g, float32 b, float32 a"),
      row<std_msgs::msg::Empty>("std_msgs/msg/Empty", "uint8 structure_needs_at_least_one_member"),
      row<std_msgs::msg::Float32>("std_msgs/msg/Float32", "float32 data"),
      row<std_msgs::msg::Float32MultiArray>("std_msgs/msg/Float32MultiArray",
                                            "std_msgs/msg/MultiArrayLayout layout, float32[] data"),
      row<std_msgs::msg::Float64>("std_msgs/msg/Float64", "float64 data"),
      row<std_msgs::msg::Float64MultiArray>("std_msgs/msg/Float64MultiArray",
                                            "std_msgs/msg/MultiArrayLayout layout, float64[] data"),
      row<std_msgs::msg::Header>("std_msgs/msg/Header",
                                 "builtin_interfaces/msg/Time stamp, string frame_id"),
      row<std_msgs::msg::Int16>("std_msgs/msg/Int16", "int16 data"),
      row<std_msgs::msg::Int16MultiArray>("std_msgs/msg/Int16MultiArray",
                                          "std_msgs/msg/MultiArrayLayout layout, int16[] data"),
      row<std_msgs::msg::Int32>("std_msgs/msg/Int32", "int32 data"),
      row<std_msgs::msg::Int32MultiArray>("std_msgs/msg/Int32MultiArray",
                                          "std_msgs/msg/MultiArrayLayout layout, int32[] data"),
      row<std_msgs::msg::Int64>("std_msgs/msg/Int64", "int64 data"),
      row<std_msgs::msg::Int64MultiArray>("std_msgs/msg/Int64MultiArray",
                                          "std_msgs/msg/MultiArrayLayout layout, int64[] data"),
      row<std_msgs::msg::Int8>("std_msgs/msg/Int8", "int8 data"),
      row<std_msgs::msg::Int8MultiArray>("std_msgs/msg/Int8MultiArray",
                                         "std_msgs/msg/MultiArrayLayout layout, int8[] data"),
      row<std_msgs::msg::MultiArrayDimension>("std_msgs/msg/MultiArrayDimension",
                                              "string label, uint32 size, uint32 stride"),
      row<std_msgs::msg::MultiArrayLayout>(
          "std_msgs/msg/MultiArrayLayout",
          "std_msgs/msg/MultiArrayDimension[] dim, uint32 data_offset"),
      row<std_msgs::msg::String>("std_msgs/msg/String", "string data"),
      row<std_msgs::msg::UInt16>("std_msgs/msg/UInt16", "uint16 data"),
      row<std_msgs::msg::UInt16MultiArray>("std_msgs/msg/UInt16MultiArray",
                                           "std_msgs/msg/MultiArrayLayout layout, uint16[] data"),
      row<std_msgs::msg::UInt32>("std_msgs/msg/UInt32", "uint32 data"),
      row<std_msgs::msg::UInt32MultiArray>("std_msgs/msg/UInt32MultiArray",
                                           "std_msgs/msg/MultiArrayLayout layout, uint32[] data"),
      row<std_msgs::msg::UInt64>("std_msgs/msg/UInt64", "uint64 data"),
      row<std_msgs::msg::UInt64MultiArray>("std_msgs/msg/UInt64MultiArray",
                                           "std_msgs/msg/MultiArrayLayout layout, uint64[] data"),
      row<std_msgs::msg::UInt8>("std_msgs/msg/UInt8", "uint8 data"),
      row<std_msgs::msg::UInt8MultiArray>("std_msgs/msg/UInt8MultiArray",
                                          "std_msgs/msg/MultiArrayLayout layout, uint8[] data"),
      row<geometry_msgs::msg::Accel>(
          "geometry_msgs/msg/Accel",
          "geometry_msgs/msg/Vector3 linear, geometry_msgs/msg/Vector3 angular"),
      row<geometry_msgs::msg::AccelStamped>(
          "geometry_msgs/msg/AccelStamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/Accel accel"),
      row<geometry_msgs::msg::AccelWithCovariance>(
          "geometry_msgs/msg/AccelWithCovariance",
          "geometry_msgs/msg/Accel accel, float64[36] covariance"),
      row<geometry_msgs::msg::AccelWithCovarianceStamped>(
          "geometry_msgs/msg/AccelWithCovarianceStamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/AccelWithCovariance accel"),
      row<geometry_msgs::msg::Inertia>(
          "geometry_msgs/msg/Inertia",
          "float64 m, geometry_msgs/msg/Vector3 com, float64 ixx, float64 ixy, float64 ixz, "
          "float64 iyy, float64 iyz, float64 izz"),
      row<geometry_msgs::msg::InertiaStamped>(
          "geometry_msgs/msg/InertiaStamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/Inertia inertia"),
      row<geometry_msgs::msg::Point>("geometry_msgs/msg/Point", "float64 x, float64 y, float64 z"),
      row<geometry_msgs::msg::Point32>("geometry_msgs/msg/Point32",
                                       "float32 x, float32 y, float32 z"),
      row<geometry_msgs::msg::PointStamped>(
          "geometry_msgs/msg/PointStamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/Point point"),
      row<geometry_msgs::msg::Polygon>("geometry_msgs/msg/Polygon",
                                       "geometry_msgs/msg/Point32[] points"),
      row<geometry_msgs::msg::PolygonStamped>(
          "geometry_msgs/msg/PolygonStamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/Polygon polygon"),
      row<geometry_msgs::msg::Pose>(
          "geometry_msgs/msg/Pose",
          "geometry_msgs/msg/Point position, geometry_msgs/msg/Quaternion orientation"),
      row<geometry_msgs::msg::Pose2D>("geometry_msgs/msg/Pose2D",
                                      "float64 x, float64 y, float64 theta"),
      row<geometry_msgs::msg::PoseArray>(
          "geometry_msgs/msg/PoseArray",
          "std_msgs/msg/Header header, geometry_msgs/msg/Pose[] poses"),
      row<geometry_msgs::msg::PoseStamped>(
          "geometry_msgs/msg/PoseStamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/Pose pose"),
      row<geometry_msgs::msg::PoseWithCovariance>(
          "geometry_msgs/msg/PoseWithCovariance",
          "geometry_msgs/msg/Pose pose, float64[36] covariance"),
      row<geometry_msgs::msg::PoseWithCovarianceStamped>(
          "geometry_msgs/msg/PoseWithCovarianceStamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/PoseWithCovariance pose"),
      row<geometry_msgs::msg::Quaternion>("geometry_msgs/msg/Quaternion",
                                          "float64 x, float64 y, float64 z, float64 w"),
      row<geometry_msgs::msg::QuaternionStamped>(
          "geometry_msgs/msg/QuaternionStamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/Quaternion quaternion"),
      row<geometry_msgs::msg::Transform>(
          "geometry_msgs/msg/Transform",
          "geometry_msgs/msg/Vector3 translation, geometry_msgs/msg/Quaternion rotation"),
      row<geometry_msgs::msg::TransformStamped>(
          "geometry_msgs/msg/TransformStamped",
          "std_msgs/msg/Header header, string child_frame_id, "
          "geometry_msgs/msg/Transform transform"),
      row<geometry_msgs::msg::Twist>(
          "geometry_msgs/msg/Twist",
          "geometry_msgs/msg/Vector3 linear, geometry_msgs/msg/Vector3 angular"),
      row<geometry_msgs::msg::TwistStamped>(
          "geometry_msgs/msg/TwistStamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/Twist twist"),
      row<geometry_msgs::msg::TwistWithCovariance>(
          "geometry_msgs/msg/TwistWithCovariance",
          "geometry_msgs/msg/Twist twist, float64[36] covariance"),
      row<geometry_msgs::msg::TwistWithCovarianceStamped>(
          "geometry_msgs/msg/TwistWithCovarianceStamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/TwistWithCovariance twist"),
      row<geometry_msgs::msg::Vector3>("geometry_msgs/msg/Vector3",
                                       "float64 x, float64 y, float64 z"),
      row<geometry_msgs::msg::Vector3Stamped>(
          "geometry_msgs/msg/Vector3Stamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/Vector3 vector"),
      row<geometry_msgs::msg::VelocityStamped>(
          "geometry_msgs/msg/VelocityStamped",
          "std_msgs/msg/Header header, string body_frame_id, string reference_frame_id, "
          "geometry_msgs/msg/Twist velocity"),
      row<geometry_msgs::msg::Wrench>(
          "geometry_msgs/msg/Wrench",
          "geometry_msgs/msg/Vector3 force, geometry_msgs/msg/Vector3 torque"),
      row<geometry_msgs::msg::WrenchStamped>(
          "geometry_msgs/msg/WrenchStamped",
          "std_msgs/msg/Header header, geometry_msgs/msg/Wrench wrench"),
      row<sensor_msgs::msg::BatteryState>(
          "sensor_msgs/msg/BatteryState",
          "std_msgs/msg/Header header, float32 voltage, float32 temperature, float32 current, "
          "float32 charge, float32 capacity, float32 design_capacity, float32 percentage, "
          "uint8 power_supply_status, uint8 power_supply_health, uint8 power_supply_technology, "
          "bool present, float32[] cell_voltage, float32[] cell_temperature, string location, "
          "string serial_number"),
      row<sensor_msgs::msg::CameraInfo>(
          "sensor_msgs/msg/CameraInfo",
          "std_msgs/msg/Header header, uint32 height, uint32 width, string distortion_model, "
          "float64[] d, float64[9] k, float64[9] r, float64[12] p, uint32 binning_x, "
          "uint32 binning_y, sensor_msgs/msg/RegionOfInterest roi"),
      row<sensor_msgs::msg::ChannelFloat32>("sensor_msgs/msg/ChannelFloat32",
                                            "string name, float32[] values"),
      row<sensor_msgs::msg::CompressedImage>(
          "sensor_msgs/msg/CompressedImage",
          "std_msgs/msg/Header header, string format, uint8[] data"),
      row<sensor_msgs::msg::FluidPressure>(
          "sensor_msgs/msg/FluidPressure",
          "std_msgs/msg/Header header, float64 fluid_pressure, float64 variance"),
      row<sensor_msgs::msg::Illuminance>(
          "sensor_msgs/msg/Illuminance",
          "std_msgs/msg/Header header, float64 illuminance, float64 variance"),
      row<sensor_msgs::msg::Image>(
          "sensor_msgs/msg/Image",
          "std_msgs/msg/Header header, uint32 height, uint32 width, string encoding, "
          "uint8 is_bigendian, uint32 step, uint8[] data"),
      row<sensor_msgs::msg::Imu>(
          "sensor_msgs/msg/Imu",
          "std_msgs/msg/Header header, geometry_msgs/msg/Quaternion orientation, "
          "float64[9] orientation_covariance, geometry_msgs/msg/Vector3 angular_velocity, "
          "float64[9] angular_velocity_covariance, geometry_msgs/msg/Vector3 linear_acceleration, "
          "float64[9] linear_acceleration_covariance"),
      row<sensor_msgs::msg::JointState>(
          "sensor_msgs/msg/JointState",
          "std_msgs/msg/Header header, string[] name, float64[] position, float64[] velocity, "
          "float64[] effort"),
      row<sensor_msgs::msg::Joy>("sensor_msgs/msg/Joy",
                                 "std_msgs/msg/Header header, float32[] axes, int32[] buttons"),
      row<sensor_msgs::msg::JoyFeedback>("sensor_msgs/msg/JoyFeedback",
                                         "uint8 type, uint8 id, float32 intensity"),
      row<sensor_msgs::msg::JoyFeedbackArray>("sensor_msgs/msg/JoyFeedbackArray",
                                              "sensor_msgs/msg/JoyFeedback[] array"),
      row<sensor_msgs::msg::LaserEcho>("sensor_msgs/msg/LaserEcho", "float32[] echoes"),
      row<sensor_msgs::msg::LaserScan>(
          "sensor_msgs/msg/LaserScan",
          "std_msgs/msg/Header header, float32 angle_min, float32 angle_max, "
          "float32 angle_increment, float32 time_increment, float32 scan_time, float32 range_min, "
          "float32 range_max, float32[] ranges, float32[] intensities"),
      row<sensor_msgs::msg::MagneticField>(
          "sensor_msgs/msg/MagneticField",
          "std_msgs/msg/Header header, geometry_msgs/msg/Vector3 magnetic_field, "
          "float64[9] magnetic_field_covariance"),
      row<sensor_msgs::msg::MultiDOFJointState>(
          "sensor_msgs/msg/MultiDOFJointState",
          "std_msgs/msg/Header header, string[] joint_names, "
          "geometry_msgs/msg/Transform[] transforms, geometry_msgs/msg/Twist[] twist, "
          "geometry_msgs/msg/Wrench[] wrench"),
      row<sensor_msgs::msg::MultiEchoLaserScan>(
          "sensor_msgs/msg/MultiEchoLaserScan",
          "std_msgs/msg/Header header, float32 angle_min, float32 angle_max, "
          "float32 angle_increment, float32 time_increment, float32 scan_time, float32 range_min, "
          "float32 range_max, sensor_msgs/msg/LaserEcho[] ranges, "
          "sensor_msgs/msg/LaserEcho[] intensities"),
      row<sensor_msgs::msg::NavSatFix>(
          "sensor_msgs/msg/NavSatFix",
          "std_msgs/msg/Header header, sensor_msgs/msg/NavSatStatus status, float64 latitude, "
          "float64 longitude, float64 altitude, float64[9] position_covariance, "
          "uint8 position_covariance_type"),
      row<sensor_msgs::msg::NavSatStatus>("sensor_msgs/msg/NavSatStatus",
                                          "int8 status, uint16 service"),
      row<sensor_msgs::msg::PointCloud>(
          "sensor_msgs/msg/PointCloud",
          "std_msgs/msg/Header header, geometry_msgs/msg/Point32[] points, "
          "sensor_msgs/msg/ChannelFloat32[] channels"),
      row<sensor_msgs::msg::PointCloud2>(
          "sensor_msgs/msg/PointCloud2",
          "std_msgs/msg/Header header, uint32 height, uint32 width, "
          "sensor_msgs/msg/PointField[] fields, bool is_bigendian, uint32 point_step, "
          "uint32 row_step, uint8[] data, bool is_dense"),
      row<sensor_msgs::msg::PointField>("sensor_msgs/msg/PointField",
                                        "string name, uint32 offset, uint8 datatype, uint32 count"),
      row<sensor_msgs::msg::Range>(
          "sensor_msgs/msg/Range",
          "std_msgs/msg/Header header, uint8 radiation_type, float32 field_of_view, "
          "float32 min_range, float32 max_range, float32 range"),
      row<sensor_msgs::msg::RegionOfInterest>(
          "sensor_msgs/msg/RegionOfInterest",
          "uint32 x_offset, uint32 y_offset, uint32 height, uint32 width, bool do_rectify"),
      row<sensor_msgs::msg::RelativeHumidity>(
          "sensor_msgs/msg/RelativeHumidity",
          "std_msgs/msg/Header header, float64 relative_humidity, float64 variance"),
      row<sensor_msgs::msg::Temperature>(
          "sensor_msgs/msg/Temperature",
          "std_msgs/msg/Header header, float64 temperature, float64 variance"),
      row<sensor_msgs::msg::TimeReference>(
          "sensor_msgs/msg/TimeReference",
          "std_msgs/msg/Header header, builtin_interfaces/msg/Time time_ref, string source"),
      row<sensor_msgs::srv::SetCameraInfo::Request>("sensor_msgs/srv/SetCameraInfo_Request",
                                                    "sensor_msgs/msg/CameraInfo camera_info"),
      row<sensor_msgs::srv::SetCameraInfo::Response>("sensor_msgs/srv/SetCameraInfo_Response",
                                                     "bool success, string status_message"),
  };
  return rows;
}

TEST(InterfaceFields, MatchRos2Humble) {
  for (const Row& row : table()) {
    EXPECT_EQ(ros_name_of(*row.message), row.name);
    EXPECT_EQ(fields_of(*row.message), row.fields) << row.name;
  }
}

TEST(InterfaceFields, NestedMessagesAreInTheTableToo) {
  std::map<std::string, std::string> fields_by_name;
  for (const Row& row : table()) fields_by_name[row.name] = row.fields;
  EXPECT_EQ(fields_by_name.size(), table().size()) << "a message is listed twice";

  // The tables reach a nested message through a pointer of their own, which must lead to the same
  // description.
  for (const Row& row : table()) {
    for (std::uint32_t index = 0; index < row.message->member_count_; ++index) {
      const introspection::MessageMember& field = row.message->members_[index];
      if (field.type_id_ != introspection::ROS_TYPE_MESSAGE) continue;
      const introspection::MessageMembers& nested = members_of(field.members_);
      EXPECT_EQ(fields_of(nested), fields_by_name[ros_name_of(nested)])
          << row.name << "." << field.name_;
    }
  }
}

TEST(InterfaceDefaults, QuaternionRotatesNothing) {
  const geometry_msgs::msg::Quaternion rotation;
  EXPECT_EQ(rotation.x, 0.0);
  EXPECT_EQ(rotation.y, 0.0);
  EXPECT_EQ(rotation.z, 0.0);
  EXPECT_EQ(rotation.w, 1.0);
}

TEST(InterfaceFields, MatchTheSchemasOfRecordedSamples) {
  const char* folder = std::getenv("AGNOCAST_GOLDEN_CDR_DIR");
  if (folder == nullptr) GTEST_SKIP() << "AGNOCAST_GOLDEN_CDR_DIR names no folder of samples";

  std::map<std::string, const introspection::MessageMembers*> ours;
  for (const Row& row : table()) ours[row.name] = row.message;
  const auto is_of_our_packages = [](const std::string& name) {
    const std::string package = name.substr(0, name.find('/'));
    return package == "builtin_interfaces" || package == "std_msgs" || package == "geometry_msgs" ||
           package == "sensor_msgs";
  };

  // Samples of other packages contain our messages as parts; these count as well.
  int compared_count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() != ".json") continue;
    const auto sample = nlohmann::json::parse(std::ifstream(entry.path()));
    if (!sample.contains("schema")) continue;
    for (const auto& [name, fields] : sample.at("schema").items()) {
      if (!is_of_our_packages(name)) continue;
      SCOPED_TRACE(entry.path().filename().string() + ": " + name);
      const auto found = ours.find(name);
      if (found == ours.end()) {
        ADD_FAILURE() << "not in our table";
        continue;
      }
      std::string recorded;
      for (const auto& field : fields) {
        append_field(recorded, field.at(1).get<std::string>(), field.at(0).get<std::string>());
      }
      EXPECT_EQ(fields_of(*found->second), recorded);
      ++compared_count;
    }
  }
  EXPECT_GT(compared_count, 0) << "no sample of our packages in " << folder;
}

}  // namespace
}  // namespace agnocast
