// SPDX-License-Identifier: Apache-2.0
//
// The constants of ROS 2 Humble, compared when this file is compiled. They are not on the wire,
// but programs rely on them. Later releases add more and keep those of Humble.

#include <action_msgs/msg/goal_status.hpp>
#include <action_msgs/srv/cancel_goal.hpp>
#include <actionlib_msgs/msg/goal_status.hpp>
#include <diagnostic_msgs/msg/diagnostic_status.hpp>
#include <nav_msgs/srv/load_map.hpp>
#include <rcl_interfaces/msg/log.hpp>
#include <rcl_interfaces/msg/parameter_type.hpp>
#include <rcl_interfaces/srv/list_parameters.hpp>
#include <sensor_msgs/msg/battery_state.hpp>
#include <sensor_msgs/msg/joy_feedback.hpp>
#include <sensor_msgs/msg/nav_sat_fix.hpp>
#include <sensor_msgs/msg/nav_sat_status.hpp>
#include <sensor_msgs/msg/point_field.hpp>
#include <sensor_msgs/msg/range.hpp>
#include <shape_msgs/msg/solid_primitive.hpp>
#include <statistics_msgs/msg/statistic_data_type.hpp>
#include <tf2_msgs/msg/tf2_error.hpp>
#include <visualization_msgs/msg/image_marker.hpp>
#include <visualization_msgs/msg/interactive_marker_control.hpp>
#include <visualization_msgs/msg/interactive_marker_feedback.hpp>
#include <visualization_msgs/msg/interactive_marker_update.hpp>
#include <visualization_msgs/msg/marker.hpp>
#include <visualization_msgs/msg/menu_entry.hpp>

namespace agnocast::test {

namespace action_msgs_goal_status {
using Message = ::action_msgs::msg::GoalStatus;
static_assert(Message::STATUS_UNKNOWN == 0);
static_assert(Message::STATUS_ACCEPTED == 1);
static_assert(Message::STATUS_EXECUTING == 2);
static_assert(Message::STATUS_CANCELING == 3);
static_assert(Message::STATUS_SUCCEEDED == 4);
static_assert(Message::STATUS_CANCELED == 5);
static_assert(Message::STATUS_ABORTED == 6);
}  // namespace action_msgs_goal_status

namespace action_msgs_cancel_goal__response {
using Message = ::action_msgs::srv::CancelGoal_Response;
static_assert(Message::ERROR_NONE == 0);
static_assert(Message::ERROR_REJECTED == 1);
static_assert(Message::ERROR_UNKNOWN_GOAL_ID == 2);
static_assert(Message::ERROR_GOAL_TERMINATED == 3);
}  // namespace action_msgs_cancel_goal__response

namespace actionlib_msgs_goal_status {
using Message = ::actionlib_msgs::msg::GoalStatus;
static_assert(Message::PENDING == 0);
static_assert(Message::ACTIVE == 1);
static_assert(Message::PREEMPTED == 2);
static_assert(Message::SUCCEEDED == 3);
static_assert(Message::ABORTED == 4);
static_assert(Message::REJECTED == 5);
static_assert(Message::PREEMPTING == 6);
static_assert(Message::RECALLING == 7);
static_assert(Message::RECALLED == 8);
static_assert(Message::LOST == 9);
}  // namespace actionlib_msgs_goal_status

namespace diagnostic_msgs_diagnostic_status {
using Message = ::diagnostic_msgs::msg::DiagnosticStatus;
static_assert(Message::OK == 0);
static_assert(Message::WARN == 1);
static_assert(Message::ERROR == 2);
static_assert(Message::STALE == 3);
}  // namespace diagnostic_msgs_diagnostic_status

namespace nav_msgs_load_map__response {
using Message = ::nav_msgs::srv::LoadMap_Response;
static_assert(Message::RESULT_SUCCESS == 0);
static_assert(Message::RESULT_MAP_DOES_NOT_EXIST == 1);
static_assert(Message::RESULT_INVALID_MAP_DATA == 2);
static_assert(Message::RESULT_INVALID_MAP_METADATA == 3);
static_assert(Message::RESULT_UNDEFINED_FAILURE == 255);
}  // namespace nav_msgs_load_map__response

namespace rcl_interfaces_log {
using Message = ::rcl_interfaces::msg::Log;
static_assert(Message::DEBUG == 10);
static_assert(Message::INFO == 20);
static_assert(Message::WARN == 30);
static_assert(Message::ERROR == 40);
static_assert(Message::FATAL == 50);
}  // namespace rcl_interfaces_log

namespace rcl_interfaces_parameter_type {
using Message = ::rcl_interfaces::msg::ParameterType;
static_assert(Message::PARAMETER_NOT_SET == 0);
static_assert(Message::PARAMETER_BOOL == 1);
static_assert(Message::PARAMETER_INTEGER == 2);
static_assert(Message::PARAMETER_DOUBLE == 3);
static_assert(Message::PARAMETER_STRING == 4);
static_assert(Message::PARAMETER_BYTE_ARRAY == 5);
static_assert(Message::PARAMETER_BOOL_ARRAY == 6);
static_assert(Message::PARAMETER_INTEGER_ARRAY == 7);
static_assert(Message::PARAMETER_DOUBLE_ARRAY == 8);
static_assert(Message::PARAMETER_STRING_ARRAY == 9);
}  // namespace rcl_interfaces_parameter_type

namespace rcl_interfaces_list_parameters__request {
using Message = ::rcl_interfaces::srv::ListParameters_Request;
static_assert(Message::DEPTH_RECURSIVE == 0);
}  // namespace rcl_interfaces_list_parameters__request

namespace sensor_msgs_battery_state {
using Message = ::sensor_msgs::msg::BatteryState;
static_assert(Message::POWER_SUPPLY_STATUS_UNKNOWN == 0);
static_assert(Message::POWER_SUPPLY_STATUS_CHARGING == 1);
static_assert(Message::POWER_SUPPLY_STATUS_DISCHARGING == 2);
static_assert(Message::POWER_SUPPLY_STATUS_NOT_CHARGING == 3);
static_assert(Message::POWER_SUPPLY_STATUS_FULL == 4);
static_assert(Message::POWER_SUPPLY_HEALTH_UNKNOWN == 0);
static_assert(Message::POWER_SUPPLY_HEALTH_GOOD == 1);
static_assert(Message::POWER_SUPPLY_HEALTH_OVERHEAT == 2);
static_assert(Message::POWER_SUPPLY_HEALTH_DEAD == 3);
static_assert(Message::POWER_SUPPLY_HEALTH_OVERVOLTAGE == 4);
static_assert(Message::POWER_SUPPLY_HEALTH_UNSPEC_FAILURE == 5);
static_assert(Message::POWER_SUPPLY_HEALTH_COLD == 6);
static_assert(Message::POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE == 7);
static_assert(Message::POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE == 8);
static_assert(Message::POWER_SUPPLY_TECHNOLOGY_UNKNOWN == 0);
static_assert(Message::POWER_SUPPLY_TECHNOLOGY_NIMH == 1);
static_assert(Message::POWER_SUPPLY_TECHNOLOGY_LION == 2);
static_assert(Message::POWER_SUPPLY_TECHNOLOGY_LIPO == 3);
static_assert(Message::POWER_SUPPLY_TECHNOLOGY_LIFE == 4);
static_assert(Message::POWER_SUPPLY_TECHNOLOGY_NICD == 5);
static_assert(Message::POWER_SUPPLY_TECHNOLOGY_LIMN == 6);
}  // namespace sensor_msgs_battery_state

namespace sensor_msgs_joy_feedback {
using Message = ::sensor_msgs::msg::JoyFeedback;
static_assert(Message::TYPE_LED == 0);
static_assert(Message::TYPE_RUMBLE == 1);
static_assert(Message::TYPE_BUZZER == 2);
}  // namespace sensor_msgs_joy_feedback

namespace sensor_msgs_nav_sat_fix {
using Message = ::sensor_msgs::msg::NavSatFix;
static_assert(Message::COVARIANCE_TYPE_UNKNOWN == 0);
static_assert(Message::COVARIANCE_TYPE_APPROXIMATED == 1);
static_assert(Message::COVARIANCE_TYPE_DIAGONAL_KNOWN == 2);
static_assert(Message::COVARIANCE_TYPE_KNOWN == 3);
}  // namespace sensor_msgs_nav_sat_fix

namespace sensor_msgs_nav_sat_status {
using Message = ::sensor_msgs::msg::NavSatStatus;
static_assert(Message::STATUS_NO_FIX == -1);
static_assert(Message::STATUS_FIX == 0);
static_assert(Message::STATUS_SBAS_FIX == 1);
static_assert(Message::STATUS_GBAS_FIX == 2);
static_assert(Message::SERVICE_GPS == 1);
static_assert(Message::SERVICE_GLONASS == 2);
static_assert(Message::SERVICE_COMPASS == 4);
static_assert(Message::SERVICE_GALILEO == 8);
}  // namespace sensor_msgs_nav_sat_status

namespace sensor_msgs_point_field {
using Message = ::sensor_msgs::msg::PointField;
static_assert(Message::INT8 == 1);
static_assert(Message::UINT8 == 2);
static_assert(Message::INT16 == 3);
static_assert(Message::UINT16 == 4);
static_assert(Message::INT32 == 5);
static_assert(Message::UINT32 == 6);
static_assert(Message::FLOAT32 == 7);
static_assert(Message::FLOAT64 == 8);
}  // namespace sensor_msgs_point_field

namespace sensor_msgs_range {
using Message = ::sensor_msgs::msg::Range;
static_assert(Message::ULTRASOUND == 0);
static_assert(Message::INFRARED == 1);
}  // namespace sensor_msgs_range

namespace shape_msgs_solid_primitive {
using Message = ::shape_msgs::msg::SolidPrimitive;
static_assert(Message::BOX == 1);
static_assert(Message::SPHERE == 2);
static_assert(Message::CYLINDER == 3);
static_assert(Message::CONE == 4);
static_assert(Message::PRISM == 5);
static_assert(Message::BOX_X == 0);
static_assert(Message::BOX_Y == 1);
static_assert(Message::BOX_Z == 2);
static_assert(Message::SPHERE_RADIUS == 0);
static_assert(Message::CYLINDER_HEIGHT == 0);
static_assert(Message::CYLINDER_RADIUS == 1);
static_assert(Message::CONE_HEIGHT == 0);
static_assert(Message::CONE_RADIUS == 1);
static_assert(Message::PRISM_HEIGHT == 0);
}  // namespace shape_msgs_solid_primitive

namespace statistics_msgs_statistic_data_type {
using Message = ::statistics_msgs::msg::StatisticDataType;
static_assert(Message::STATISTICS_DATA_TYPE_UNINITIALIZED == 0);
static_assert(Message::STATISTICS_DATA_TYPE_AVERAGE == 1);
static_assert(Message::STATISTICS_DATA_TYPE_MINIMUM == 2);
static_assert(Message::STATISTICS_DATA_TYPE_MAXIMUM == 3);
static_assert(Message::STATISTICS_DATA_TYPE_STDDEV == 4);
static_assert(Message::STATISTICS_DATA_TYPE_SAMPLE_COUNT == 5);
}  // namespace statistics_msgs_statistic_data_type

namespace tf2_msgs_tf2_error {
using Message = ::tf2_msgs::msg::TF2Error;
static_assert(Message::NO_ERROR == 0);
static_assert(Message::LOOKUP_ERROR == 1);
static_assert(Message::CONNECTIVITY_ERROR == 2);
static_assert(Message::EXTRAPOLATION_ERROR == 3);
static_assert(Message::INVALID_ARGUMENT_ERROR == 4);
static_assert(Message::TIMEOUT_ERROR == 5);
static_assert(Message::TRANSFORM_ERROR == 6);
}  // namespace tf2_msgs_tf2_error

namespace visualization_msgs_image_marker {
using Message = ::visualization_msgs::msg::ImageMarker;
static_assert(Message::CIRCLE == 0);
static_assert(Message::LINE_STRIP == 1);
static_assert(Message::LINE_LIST == 2);
static_assert(Message::POLYGON == 3);
static_assert(Message::POINTS == 4);
static_assert(Message::ADD == 0);
static_assert(Message::REMOVE == 1);
}  // namespace visualization_msgs_image_marker

namespace visualization_msgs_interactive_marker_control {
using Message = ::visualization_msgs::msg::InteractiveMarkerControl;
static_assert(Message::INHERIT == 0);
static_assert(Message::FIXED == 1);
static_assert(Message::VIEW_FACING == 2);
static_assert(Message::NONE == 0);
static_assert(Message::MENU == 1);
static_assert(Message::BUTTON == 2);
static_assert(Message::MOVE_AXIS == 3);
static_assert(Message::MOVE_PLANE == 4);
static_assert(Message::ROTATE_AXIS == 5);
static_assert(Message::MOVE_ROTATE == 6);
static_assert(Message::MOVE_3D == 7);
static_assert(Message::ROTATE_3D == 8);
static_assert(Message::MOVE_ROTATE_3D == 9);
}  // namespace visualization_msgs_interactive_marker_control

namespace visualization_msgs_interactive_marker_feedback {
using Message = ::visualization_msgs::msg::InteractiveMarkerFeedback;
static_assert(Message::KEEP_ALIVE == 0);
static_assert(Message::POSE_UPDATE == 1);
static_assert(Message::MENU_SELECT == 2);
static_assert(Message::BUTTON_CLICK == 3);
static_assert(Message::MOUSE_DOWN == 4);
static_assert(Message::MOUSE_UP == 5);
}  // namespace visualization_msgs_interactive_marker_feedback

namespace visualization_msgs_interactive_marker_update {
using Message = ::visualization_msgs::msg::InteractiveMarkerUpdate;
static_assert(Message::KEEP_ALIVE == 0);
static_assert(Message::UPDATE == 1);
}  // namespace visualization_msgs_interactive_marker_update

namespace visualization_msgs_marker {
using Message = ::visualization_msgs::msg::Marker;
static_assert(Message::ARROW == 0);
static_assert(Message::CUBE == 1);
static_assert(Message::SPHERE == 2);
static_assert(Message::CYLINDER == 3);
static_assert(Message::LINE_STRIP == 4);
static_assert(Message::LINE_LIST == 5);
static_assert(Message::CUBE_LIST == 6);
static_assert(Message::SPHERE_LIST == 7);
static_assert(Message::POINTS == 8);
static_assert(Message::TEXT_VIEW_FACING == 9);
static_assert(Message::MESH_RESOURCE == 10);
static_assert(Message::TRIANGLE_LIST == 11);
static_assert(Message::ADD == 0);
static_assert(Message::MODIFY == 0);
static_assert(Message::DELETE == 2);
static_assert(Message::DELETEALL == 3);
}  // namespace visualization_msgs_marker

namespace visualization_msgs_menu_entry {
using Message = ::visualization_msgs::msg::MenuEntry;
static_assert(Message::FEEDBACK == 0);
static_assert(Message::ROSRUN == 1);
static_assert(Message::ROSLAUNCH == 2);
}  // namespace visualization_msgs_menu_entry

}  // namespace agnocast::test
