// SPDX-License-Identifier: Apache-2.0
//
// The fields of every message of ROS 2 Humble in interfaces/: type and name, in order. They were
// copied from ROS 2, not from interfaces/, so that a mistake there is found. The generator gives a
// message without fields a hidden one, which is on the wire; a field declared char is a uint8. An
// action is eight messages.
#pragma once

namespace agnocast::test {

struct ExpectedFields {
  const char* name;
  const char* fields;
};

inline constexpr ExpectedFields expected_fields[] = {
    {"action_msgs/msg/GoalInfo",
     "unique_identifier_msgs/msg/UUID goal_id, builtin_interfaces/msg/Time stamp"},
    {"action_msgs/msg/GoalStatus", "action_msgs/msg/GoalInfo goal_info, int8 status"},
    {"action_msgs/msg/GoalStatusArray", "action_msgs/msg/GoalStatus[] status_list"},
    {"action_msgs/srv/CancelGoal_Request", "action_msgs/msg/GoalInfo goal_info"},
    {"action_msgs/srv/CancelGoal_Response",
     "int8 return_code, action_msgs/msg/GoalInfo[] goals_canceling"},
    {"actionlib_msgs/msg/GoalID", "builtin_interfaces/msg/Time stamp, string id"},
    {"actionlib_msgs/msg/GoalStatus",
     "actionlib_msgs/msg/GoalID goal_id, uint8 status, string text"},
    {"actionlib_msgs/msg/GoalStatusArray",
     "std_msgs/msg/Header header, actionlib_msgs/msg/GoalStatus[] status_list"},
    {"builtin_interfaces/msg/Duration", "int32 sec, uint32 nanosec"},
    {"builtin_interfaces/msg/Time", "int32 sec, uint32 nanosec"},
    {"diagnostic_msgs/msg/DiagnosticArray",
     "std_msgs/msg/Header header, diagnostic_msgs/msg/DiagnosticStatus[] status"},
    {"diagnostic_msgs/msg/DiagnosticStatus",
     "byte level, string name, string message, string hardware_id, "
     "diagnostic_msgs/msg/KeyValue[] values"},
    {"diagnostic_msgs/msg/KeyValue", "string key, string value"},
    {"diagnostic_msgs/srv/AddDiagnostics_Request", "string load_namespace"},
    {"diagnostic_msgs/srv/AddDiagnostics_Response", "bool success, string message"},
    {"diagnostic_msgs/srv/SelfTest_Request", "uint8 structure_needs_at_least_one_member"},
    {"diagnostic_msgs/srv/SelfTest_Response",
     "string id, byte passed, diagnostic_msgs/msg/DiagnosticStatus[] status"},
    {"example_interfaces/msg/Bool", "bool data"},
    {"example_interfaces/msg/Byte", "byte data"},
    {"example_interfaces/msg/ByteMultiArray",
     "example_interfaces/msg/MultiArrayLayout layout, byte[] data"},
    {"example_interfaces/msg/Char", "uint8 data"},
    {"example_interfaces/msg/Empty", "uint8 structure_needs_at_least_one_member"},
    {"example_interfaces/msg/Float32", "float32 data"},
    {"example_interfaces/msg/Float32MultiArray",
     "example_interfaces/msg/MultiArrayLayout layout, float32[] data"},
    {"example_interfaces/msg/Float64", "float64 data"},
    {"example_interfaces/msg/Float64MultiArray",
     "example_interfaces/msg/MultiArrayLayout layout, float64[] data"},
    {"example_interfaces/msg/Int16", "int16 data"},
    {"example_interfaces/msg/Int16MultiArray",
     "example_interfaces/msg/MultiArrayLayout layout, int16[] data"},
    {"example_interfaces/msg/Int32", "int32 data"},
    {"example_interfaces/msg/Int32MultiArray",
     "example_interfaces/msg/MultiArrayLayout layout, int32[] data"},
    {"example_interfaces/msg/Int64", "int64 data"},
    {"example_interfaces/msg/Int64MultiArray",
     "example_interfaces/msg/MultiArrayLayout layout, int64[] data"},
    {"example_interfaces/msg/Int8", "int8 data"},
    {"example_interfaces/msg/Int8MultiArray",
     "example_interfaces/msg/MultiArrayLayout layout, int8[] data"},
    {"example_interfaces/msg/MultiArrayDimension", "string label, uint32 size, uint32 stride"},
    {"example_interfaces/msg/MultiArrayLayout",
     "example_interfaces/msg/MultiArrayDimension[] dim, uint32 data_offset"},
    {"example_interfaces/msg/String", "string data"},
    {"example_interfaces/msg/UInt16", "uint16 data"},
    {"example_interfaces/msg/UInt16MultiArray",
     "example_interfaces/msg/MultiArrayLayout layout, uint16[] data"},
    {"example_interfaces/msg/UInt32", "uint32 data"},
    {"example_interfaces/msg/UInt32MultiArray",
     "example_interfaces/msg/MultiArrayLayout layout, uint32[] data"},
    {"example_interfaces/msg/UInt64", "uint64 data"},
    {"example_interfaces/msg/UInt64MultiArray",
     "example_interfaces/msg/MultiArrayLayout layout, uint64[] data"},
    {"example_interfaces/msg/UInt8", "uint8 data"},
    {"example_interfaces/msg/UInt8MultiArray",
     "example_interfaces/msg/MultiArrayLayout layout, uint8[] data"},
    {"example_interfaces/msg/WString", "wstring data"},
    {"example_interfaces/srv/AddTwoInts_Request", "int64 a, int64 b"},
    {"example_interfaces/srv/AddTwoInts_Response", "int64 sum"},
    {"example_interfaces/srv/SetBool_Request", "bool data"},
    {"example_interfaces/srv/SetBool_Response", "bool success, string message"},
    {"example_interfaces/srv/Trigger_Request", "uint8 structure_needs_at_least_one_member"},
    {"example_interfaces/srv/Trigger_Response", "bool success, string message"},
    {"example_interfaces/action/Fibonacci_Goal", "int32 order"},
    {"example_interfaces/action/Fibonacci_Result", "int32[] sequence"},
    {"example_interfaces/action/Fibonacci_Feedback", "int32[] sequence"},
    {"example_interfaces/action/Fibonacci_SendGoal_Request",
     "unique_identifier_msgs/msg/UUID goal_id, example_interfaces/action/Fibonacci_Goal goal"},
    {"example_interfaces/action/Fibonacci_SendGoal_Response",
     "bool accepted, builtin_interfaces/msg/Time stamp"},
    {"example_interfaces/action/Fibonacci_GetResult_Request",
     "unique_identifier_msgs/msg/UUID goal_id"},
    {"example_interfaces/action/Fibonacci_GetResult_Response",
     "int8 status, example_interfaces/action/Fibonacci_Result result"},
    {"example_interfaces/action/Fibonacci_FeedbackMessage",
     "unique_identifier_msgs/msg/UUID goal_id, "
     "example_interfaces/action/Fibonacci_Feedback feedback"},
    {"geometry_msgs/msg/Accel",
     "geometry_msgs/msg/Vector3 linear, geometry_msgs/msg/Vector3 angular"},
    {"geometry_msgs/msg/AccelStamped", "std_msgs/msg/Header header, geometry_msgs/msg/Accel accel"},
    {"geometry_msgs/msg/AccelWithCovariance",
     "geometry_msgs/msg/Accel accel, float64[36] covariance"},
    {"geometry_msgs/msg/AccelWithCovarianceStamped",
     "std_msgs/msg/Header header, geometry_msgs/msg/AccelWithCovariance accel"},
    {"geometry_msgs/msg/Inertia",
     "float64 m, geometry_msgs/msg/Vector3 com, float64 ixx, float64 ixy, float64 ixz, "
     "float64 iyy, float64 iyz, float64 izz"},
    {"geometry_msgs/msg/InertiaStamped",
     "std_msgs/msg/Header header, geometry_msgs/msg/Inertia inertia"},
    {"geometry_msgs/msg/Point", "float64 x, float64 y, float64 z"},
    {"geometry_msgs/msg/Point32", "float32 x, float32 y, float32 z"},
    {"geometry_msgs/msg/PointStamped", "std_msgs/msg/Header header, geometry_msgs/msg/Point point"},
    {"geometry_msgs/msg/Polygon", "geometry_msgs/msg/Point32[] points"},
    {"geometry_msgs/msg/PolygonStamped",
     "std_msgs/msg/Header header, geometry_msgs/msg/Polygon polygon"},
    {"geometry_msgs/msg/Pose",
     "geometry_msgs/msg/Point position, geometry_msgs/msg/Quaternion orientation"},
    {"geometry_msgs/msg/Pose2D", "float64 x, float64 y, float64 theta"},
    {"geometry_msgs/msg/PoseArray", "std_msgs/msg/Header header, geometry_msgs/msg/Pose[] poses"},
    {"geometry_msgs/msg/PoseStamped", "std_msgs/msg/Header header, geometry_msgs/msg/Pose pose"},
    {"geometry_msgs/msg/PoseWithCovariance", "geometry_msgs/msg/Pose pose, float64[36] covariance"},
    {"geometry_msgs/msg/PoseWithCovarianceStamped",
     "std_msgs/msg/Header header, geometry_msgs/msg/PoseWithCovariance pose"},
    {"geometry_msgs/msg/Quaternion", "float64 x, float64 y, float64 z, float64 w"},
    {"geometry_msgs/msg/QuaternionStamped",
     "std_msgs/msg/Header header, geometry_msgs/msg/Quaternion quaternion"},
    {"geometry_msgs/msg/Transform",
     "geometry_msgs/msg/Vector3 translation, geometry_msgs/msg/Quaternion rotation"},
    {"geometry_msgs/msg/TransformStamped",
     "std_msgs/msg/Header header, string child_frame_id, geometry_msgs/msg/Transform transform"},
    {"geometry_msgs/msg/Twist",
     "geometry_msgs/msg/Vector3 linear, geometry_msgs/msg/Vector3 angular"},
    {"geometry_msgs/msg/TwistStamped", "std_msgs/msg/Header header, geometry_msgs/msg/Twist twist"},
    {"geometry_msgs/msg/TwistWithCovariance",
     "geometry_msgs/msg/Twist twist, float64[36] covariance"},
    {"geometry_msgs/msg/TwistWithCovarianceStamped",
     "std_msgs/msg/Header header, geometry_msgs/msg/TwistWithCovariance twist"},
    {"geometry_msgs/msg/Vector3", "float64 x, float64 y, float64 z"},
    {"geometry_msgs/msg/Vector3Stamped",
     "std_msgs/msg/Header header, geometry_msgs/msg/Vector3 vector"},
    {"geometry_msgs/msg/VelocityStamped",
     "std_msgs/msg/Header header, string body_frame_id, string reference_frame_id, "
     "geometry_msgs/msg/Twist velocity"},
    {"geometry_msgs/msg/Wrench",
     "geometry_msgs/msg/Vector3 force, geometry_msgs/msg/Vector3 torque"},
    {"geometry_msgs/msg/WrenchStamped",
     "std_msgs/msg/Header header, geometry_msgs/msg/Wrench wrench"},
    {"nav_msgs/msg/GridCells",
     "std_msgs/msg/Header header, float32 cell_width, float32 cell_height, "
     "geometry_msgs/msg/Point[] cells"},
    {"nav_msgs/msg/MapMetaData",
     "builtin_interfaces/msg/Time map_load_time, float32 resolution, uint32 width, uint32 height, "
     "geometry_msgs/msg/Pose origin"},
    {"nav_msgs/msg/OccupancyGrid",
     "std_msgs/msg/Header header, nav_msgs/msg/MapMetaData info, int8[] data"},
    {"nav_msgs/msg/Odometry",
     "std_msgs/msg/Header header, string child_frame_id, "
     "geometry_msgs/msg/PoseWithCovariance pose, geometry_msgs/msg/TwistWithCovariance twist"},
    {"nav_msgs/msg/Path", "std_msgs/msg/Header header, geometry_msgs/msg/PoseStamped[] poses"},
    {"nav_msgs/srv/GetMap_Request", "uint8 structure_needs_at_least_one_member"},
    {"nav_msgs/srv/GetMap_Response", "nav_msgs/msg/OccupancyGrid map"},
    {"nav_msgs/srv/GetPlan_Request",
     "geometry_msgs/msg/PoseStamped start, geometry_msgs/msg/PoseStamped goal, float32 tolerance"},
    {"nav_msgs/srv/GetPlan_Response", "nav_msgs/msg/Path plan"},
    {"nav_msgs/srv/LoadMap_Request", "string map_url"},
    {"nav_msgs/srv/LoadMap_Response", "nav_msgs/msg/OccupancyGrid map, uint8 result"},
    {"nav_msgs/srv/SetMap_Request",
     "nav_msgs/msg/OccupancyGrid map, geometry_msgs/msg/PoseWithCovarianceStamped initial_pose"},
    {"nav_msgs/srv/SetMap_Response", "bool success"},
    {"rcl_interfaces/msg/FloatingPointRange", "float64 from_value, float64 to_value, float64 step"},
    {"rcl_interfaces/msg/IntegerRange", "int64 from_value, int64 to_value, uint64 step"},
    {"rcl_interfaces/msg/ListParametersResult", "string[] names, string[] prefixes"},
    {"rcl_interfaces/msg/Log",
     "builtin_interfaces/msg/Time stamp, uint8 level, string name, string msg, string file, "
     "string function, uint32 line"},
    {"rcl_interfaces/msg/Parameter", "string name, rcl_interfaces/msg/ParameterValue value"},
    {"rcl_interfaces/msg/ParameterDescriptor",
     "string name, uint8 type, string description, string additional_constraints, bool read_only, "
     "bool dynamic_typing, rcl_interfaces/msg/FloatingPointRange[<=1] floating_point_range, "
     "rcl_interfaces/msg/IntegerRange[<=1] integer_range"},
    {"rcl_interfaces/msg/ParameterEvent",
     "builtin_interfaces/msg/Time stamp, string node, "
     "rcl_interfaces/msg/Parameter[] new_parameters, "
     "rcl_interfaces/msg/Parameter[] changed_parameters, "
     "rcl_interfaces/msg/Parameter[] deleted_parameters"},
    {"rcl_interfaces/msg/ParameterEventDescriptors",
     "rcl_interfaces/msg/ParameterDescriptor[] new_parameters, "
     "rcl_interfaces/msg/ParameterDescriptor[] changed_parameters, "
     "rcl_interfaces/msg/ParameterDescriptor[] deleted_parameters"},
    {"rcl_interfaces/msg/ParameterType", "uint8 structure_needs_at_least_one_member"},
    {"rcl_interfaces/msg/ParameterValue",
     "uint8 type, bool bool_value, int64 integer_value, float64 double_value, "
     "string string_value, byte[] byte_array_value, bool[] bool_array_value, "
     "int64[] integer_array_value, float64[] double_array_value, string[] string_array_value"},
    {"rcl_interfaces/msg/SetParametersResult", "bool successful, string reason"},
    {"rcl_interfaces/srv/DescribeParameters_Request", "string[] names"},
    {"rcl_interfaces/srv/DescribeParameters_Response",
     "rcl_interfaces/msg/ParameterDescriptor[] descriptors"},
    {"rcl_interfaces/srv/GetParameterTypes_Request", "string[] names"},
    {"rcl_interfaces/srv/GetParameterTypes_Response", "uint8[] types"},
    {"rcl_interfaces/srv/GetParameters_Request", "string[] names"},
    {"rcl_interfaces/srv/GetParameters_Response", "rcl_interfaces/msg/ParameterValue[] values"},
    {"rcl_interfaces/srv/ListParameters_Request", "string[] prefixes, uint64 depth"},
    {"rcl_interfaces/srv/ListParameters_Response",
     "rcl_interfaces/msg/ListParametersResult result"},
    {"rcl_interfaces/srv/SetParameters_Request", "rcl_interfaces/msg/Parameter[] parameters"},
    {"rcl_interfaces/srv/SetParameters_Response",
     "rcl_interfaces/msg/SetParametersResult[] results"},
    {"rcl_interfaces/srv/SetParametersAtomically_Request",
     "rcl_interfaces/msg/Parameter[] parameters"},
    {"rcl_interfaces/srv/SetParametersAtomically_Response",
     "rcl_interfaces/msg/SetParametersResult result"},
    {"rmw_dds_common/msg/Gid", "uint8[24] data"},
    {"rmw_dds_common/msg/NodeEntitiesInfo",
     "string<=256 node_namespace, string<=256 node_name, rmw_dds_common/msg/Gid[] reader_gid_seq, "
     "rmw_dds_common/msg/Gid[] writer_gid_seq"},
    {"rmw_dds_common/msg/ParticipantEntitiesInfo",
     "rmw_dds_common/msg/Gid gid, rmw_dds_common/msg/NodeEntitiesInfo[] node_entities_info_seq"},
    {"rosgraph_msgs/msg/Clock", "builtin_interfaces/msg/Time clock"},
    {"sensor_msgs/msg/BatteryState",
     "std_msgs/msg/Header header, float32 voltage, float32 temperature, float32 current, "
     "float32 charge, float32 capacity, float32 design_capacity, float32 percentage, "
     "uint8 power_supply_status, uint8 power_supply_health, uint8 power_supply_technology, "
     "bool present, float32[] cell_voltage, float32[] cell_temperature, string location, "
     "string serial_number"},
    {"sensor_msgs/msg/CameraInfo",
     "std_msgs/msg/Header header, uint32 height, uint32 width, string distortion_model, "
     "float64[] d, float64[9] k, float64[9] r, float64[12] p, uint32 binning_x, uint32 binning_y, "
     "sensor_msgs/msg/RegionOfInterest roi"},
    {"sensor_msgs/msg/ChannelFloat32", "string name, float32[] values"},
    {"sensor_msgs/msg/CompressedImage", "std_msgs/msg/Header header, string format, uint8[] data"},
    {"sensor_msgs/msg/FluidPressure",
     "std_msgs/msg/Header header, float64 fluid_pressure, float64 variance"},
    {"sensor_msgs/msg/Illuminance",
     "std_msgs/msg/Header header, float64 illuminance, float64 variance"},
    {"sensor_msgs/msg/Image",
     "std_msgs/msg/Header header, uint32 height, uint32 width, string encoding, "
     "uint8 is_bigendian, uint32 step, uint8[] data"},
    {"sensor_msgs/msg/Imu",
     "std_msgs/msg/Header header, geometry_msgs/msg/Quaternion orientation, "
     "float64[9] orientation_covariance, geometry_msgs/msg/Vector3 angular_velocity, "
     "float64[9] angular_velocity_covariance, geometry_msgs/msg/Vector3 linear_acceleration, "
     "float64[9] linear_acceleration_covariance"},
    {"sensor_msgs/msg/JointState",
     "std_msgs/msg/Header header, string[] name, float64[] position, float64[] velocity, "
     "float64[] effort"},
    {"sensor_msgs/msg/Joy", "std_msgs/msg/Header header, float32[] axes, int32[] buttons"},
    {"sensor_msgs/msg/JoyFeedback", "uint8 type, uint8 id, float32 intensity"},
    {"sensor_msgs/msg/JoyFeedbackArray", "sensor_msgs/msg/JoyFeedback[] array"},
    {"sensor_msgs/msg/LaserEcho", "float32[] echoes"},
    {"sensor_msgs/msg/LaserScan",
     "std_msgs/msg/Header header, float32 angle_min, float32 angle_max, float32 angle_increment, "
     "float32 time_increment, float32 scan_time, float32 range_min, float32 range_max, "
     "float32[] ranges, float32[] intensities"},
    {"sensor_msgs/msg/MagneticField",
     "std_msgs/msg/Header header, geometry_msgs/msg/Vector3 magnetic_field, "
     "float64[9] magnetic_field_covariance"},
    {"sensor_msgs/msg/MultiDOFJointState",
     "std_msgs/msg/Header header, string[] joint_names, geometry_msgs/msg/Transform[] transforms, "
     "geometry_msgs/msg/Twist[] twist, geometry_msgs/msg/Wrench[] wrench"},
    {"sensor_msgs/msg/MultiEchoLaserScan",
     "std_msgs/msg/Header header, float32 angle_min, float32 angle_max, float32 angle_increment, "
     "float32 time_increment, float32 scan_time, float32 range_min, float32 range_max, "
     "sensor_msgs/msg/LaserEcho[] ranges, sensor_msgs/msg/LaserEcho[] intensities"},
    {"sensor_msgs/msg/NavSatFix",
     "std_msgs/msg/Header header, sensor_msgs/msg/NavSatStatus status, float64 latitude, "
     "float64 longitude, float64 altitude, float64[9] position_covariance, "
     "uint8 position_covariance_type"},
    {"sensor_msgs/msg/NavSatStatus", "int8 status, uint16 service"},
    {"sensor_msgs/msg/PointCloud",
     "std_msgs/msg/Header header, geometry_msgs/msg/Point32[] points, "
     "sensor_msgs/msg/ChannelFloat32[] channels"},
    {"sensor_msgs/msg/PointCloud2",
     "std_msgs/msg/Header header, uint32 height, uint32 width, "
     "sensor_msgs/msg/PointField[] fields, bool is_bigendian, uint32 point_step, uint32 row_step, "
     "uint8[] data, bool is_dense"},
    {"sensor_msgs/msg/PointField", "string name, uint32 offset, uint8 datatype, uint32 count"},
    {"sensor_msgs/msg/Range",
     "std_msgs/msg/Header header, uint8 radiation_type, float32 field_of_view, float32 min_range, "
     "float32 max_range, float32 range"},
    {"sensor_msgs/msg/RegionOfInterest",
     "uint32 x_offset, uint32 y_offset, uint32 height, uint32 width, bool do_rectify"},
    {"sensor_msgs/msg/RelativeHumidity",
     "std_msgs/msg/Header header, float64 relative_humidity, float64 variance"},
    {"sensor_msgs/msg/Temperature",
     "std_msgs/msg/Header header, float64 temperature, float64 variance"},
    {"sensor_msgs/msg/TimeReference",
     "std_msgs/msg/Header header, builtin_interfaces/msg/Time time_ref, string source"},
    {"sensor_msgs/srv/SetCameraInfo_Request", "sensor_msgs/msg/CameraInfo camera_info"},
    {"sensor_msgs/srv/SetCameraInfo_Response", "bool success, string status_message"},
    {"shape_msgs/msg/Mesh",
     "shape_msgs/msg/MeshTriangle[] triangles, geometry_msgs/msg/Point[] vertices"},
    {"shape_msgs/msg/MeshTriangle", "uint32[3] vertex_indices"},
    {"shape_msgs/msg/Plane", "float64[4] coef"},
    {"shape_msgs/msg/SolidPrimitive",
     "uint8 type, float64[<=3] dimensions, geometry_msgs/msg/Polygon polygon"},
    {"statistics_msgs/msg/MetricsMessage",
     "string measurement_source_name, string metrics_source, string unit, "
     "builtin_interfaces/msg/Time window_start, builtin_interfaces/msg/Time window_stop, "
     "statistics_msgs/msg/StatisticDataPoint[] statistics"},
    {"statistics_msgs/msg/StatisticDataPoint", "uint8 data_type, float64 data"},
    {"statistics_msgs/msg/StatisticDataType", "uint8 structure_needs_at_least_one_member"},
    {"std_msgs/msg/Bool", "bool data"},
    {"std_msgs/msg/Byte", "byte data"},
    {"std_msgs/msg/ByteMultiArray", "std_msgs/msg/MultiArrayLayout layout, byte[] data"},
    {"std_msgs/msg/Char", "uint8 data"},
    {"std_msgs/msg/ColorRGBA", "float32 r, float32 g, float32 b, float32 a"},
    {"std_msgs/msg/Empty", "uint8 structure_needs_at_least_one_member"},
    {"std_msgs/msg/Float32", "float32 data"},
    {"std_msgs/msg/Float32MultiArray", "std_msgs/msg/MultiArrayLayout layout, float32[] data"},
    {"std_msgs/msg/Float64", "float64 data"},
    {"std_msgs/msg/Float64MultiArray", "std_msgs/msg/MultiArrayLayout layout, float64[] data"},
    {"std_msgs/msg/Header", "builtin_interfaces/msg/Time stamp, string frame_id"},
    {"std_msgs/msg/Int16", "int16 data"},
    {"std_msgs/msg/Int16MultiArray", "std_msgs/msg/MultiArrayLayout layout, int16[] data"},
    {"std_msgs/msg/Int32", "int32 data"},
    {"std_msgs/msg/Int32MultiArray", "std_msgs/msg/MultiArrayLayout layout, int32[] data"},
    {"std_msgs/msg/Int64", "int64 data"},
    {"std_msgs/msg/Int64MultiArray", "std_msgs/msg/MultiArrayLayout layout, int64[] data"},
    {"std_msgs/msg/Int8", "int8 data"},
    {"std_msgs/msg/Int8MultiArray", "std_msgs/msg/MultiArrayLayout layout, int8[] data"},
    {"std_msgs/msg/MultiArrayDimension", "string label, uint32 size, uint32 stride"},
    {"std_msgs/msg/MultiArrayLayout", "std_msgs/msg/MultiArrayDimension[] dim, uint32 data_offset"},
    {"std_msgs/msg/String", "string data"},
    {"std_msgs/msg/UInt16", "uint16 data"},
    {"std_msgs/msg/UInt16MultiArray", "std_msgs/msg/MultiArrayLayout layout, uint16[] data"},
    {"std_msgs/msg/UInt32", "uint32 data"},
    {"std_msgs/msg/UInt32MultiArray", "std_msgs/msg/MultiArrayLayout layout, uint32[] data"},
    {"std_msgs/msg/UInt64", "uint64 data"},
    {"std_msgs/msg/UInt64MultiArray", "std_msgs/msg/MultiArrayLayout layout, uint64[] data"},
    {"std_msgs/msg/UInt8", "uint8 data"},
    {"std_msgs/msg/UInt8MultiArray", "std_msgs/msg/MultiArrayLayout layout, uint8[] data"},
    {"std_srvs/srv/Empty_Request", "uint8 structure_needs_at_least_one_member"},
    {"std_srvs/srv/Empty_Response", "uint8 structure_needs_at_least_one_member"},
    {"std_srvs/srv/SetBool_Request", "bool data"},
    {"std_srvs/srv/SetBool_Response", "bool success, string message"},
    {"std_srvs/srv/Trigger_Request", "uint8 structure_needs_at_least_one_member"},
    {"std_srvs/srv/Trigger_Response", "bool success, string message"},
    {"stereo_msgs/msg/DisparityImage",
     "std_msgs/msg/Header header, sensor_msgs/msg/Image image, float32 f, float32 t, "
     "sensor_msgs/msg/RegionOfInterest valid_window, float32 min_disparity, "
     "float32 max_disparity, float32 delta_d"},
    {"test_msgs/msg/Arrays",
     "bool[3] bool_values, byte[3] byte_values, uint8[3] char_values, float32[3] float32_values, "
     "float64[3] float64_values, int8[3] int8_values, uint8[3] uint8_values, "
     "int16[3] int16_values, uint16[3] uint16_values, int32[3] int32_values, "
     "uint32[3] uint32_values, int64[3] int64_values, uint64[3] uint64_values, "
     "string[3] string_values, test_msgs/msg/BasicTypes[3] basic_types_values, "
     "test_msgs/msg/Constants[3] constants_values, test_msgs/msg/Defaults[3] defaults_values, "
     "bool[3] bool_values_default, byte[3] byte_values_default, uint8[3] char_values_default, "
     "float32[3] float32_values_default, float64[3] float64_values_default, "
     "int8[3] int8_values_default, uint8[3] uint8_values_default, int16[3] int16_values_default, "
     "uint16[3] uint16_values_default, int32[3] int32_values_default, "
     "uint32[3] uint32_values_default, int64[3] int64_values_default, "
     "uint64[3] uint64_values_default, string[3] string_values_default, int32 alignment_check"},
    {"test_msgs/msg/BasicTypes",
     "bool bool_value, byte byte_value, uint8 char_value, float32 float32_value, "
     "float64 float64_value, int8 int8_value, uint8 uint8_value, int16 int16_value, "
     "uint16 uint16_value, int32 int32_value, uint32 uint32_value, int64 int64_value, "
     "uint64 uint64_value"},
    {"test_msgs/msg/BoundedPlainSequences",
     "bool[<=3] bool_values, byte[<=3] byte_values, uint8[<=3] char_values, "
     "float32[<=3] float32_values, float64[<=3] float64_values, int8[<=3] int8_values, "
     "uint8[<=3] uint8_values, int16[<=3] int16_values, uint16[<=3] uint16_values, "
     "int32[<=3] int32_values, uint32[<=3] uint32_values, int64[<=3] int64_values, "
     "uint64[<=3] uint64_values, test_msgs/msg/BasicTypes[<=3] basic_types_values, "
     "test_msgs/msg/Constants[<=3] constants_values, test_msgs/msg/Defaults[<=3] defaults_values, "
     "bool[<=3] bool_values_default, byte[<=3] byte_values_default, "
     "uint8[<=3] char_values_default, float32[<=3] float32_values_default, "
     "float64[<=3] float64_values_default, int8[<=3] int8_values_default, "
     "uint8[<=3] uint8_values_default, int16[<=3] int16_values_default, "
     "uint16[<=3] uint16_values_default, int32[<=3] int32_values_default, "
     "uint32[<=3] uint32_values_default, int64[<=3] int64_values_default, "
     "uint64[<=3] uint64_values_default, int32 alignment_check"},
    {"test_msgs/msg/BoundedSequences",
     "bool[<=3] bool_values, byte[<=3] byte_values, uint8[<=3] char_values, "
     "float32[<=3] float32_values, float64[<=3] float64_values, int8[<=3] int8_values, "
     "uint8[<=3] uint8_values, int16[<=3] int16_values, uint16[<=3] uint16_values, "
     "int32[<=3] int32_values, uint32[<=3] uint32_values, int64[<=3] int64_values, "
     "uint64[<=3] uint64_values, string[<=3] string_values, "
     "test_msgs/msg/BasicTypes[<=3] basic_types_values, "
     "test_msgs/msg/Constants[<=3] constants_values, test_msgs/msg/Defaults[<=3] defaults_values, "
     "bool[<=3] bool_values_default, byte[<=3] byte_values_default, "
     "uint8[<=3] char_values_default, float32[<=3] float32_values_default, "
     "float64[<=3] float64_values_default, int8[<=3] int8_values_default, "
     "uint8[<=3] uint8_values_default, int16[<=3] int16_values_default, "
     "uint16[<=3] uint16_values_default, int32[<=3] int32_values_default, "
     "uint32[<=3] uint32_values_default, int64[<=3] int64_values_default, "
     "uint64[<=3] uint64_values_default, string[<=3] string_values_default, int32 alignment_check"},
    {"test_msgs/msg/Builtins",
     "builtin_interfaces/msg/Duration duration_value, builtin_interfaces/msg/Time time_value"},
    {"test_msgs/msg/Constants", "uint8 structure_needs_at_least_one_member"},
    {"test_msgs/msg/Defaults",
     "bool bool_value, byte byte_value, uint8 char_value, float32 float32_value, "
     "float64 float64_value, int8 int8_value, uint8 uint8_value, int16 int16_value, "
     "uint16 uint16_value, int32 int32_value, uint32 uint32_value, int64 int64_value, "
     "uint64 uint64_value"},
    {"test_msgs/msg/Empty", "uint8 structure_needs_at_least_one_member"},
    {"test_msgs/msg/MultiNested",
     "test_msgs/msg/Arrays[3] array_of_arrays, "
     "test_msgs/msg/BoundedSequences[3] array_of_bounded_sequences, "
     "test_msgs/msg/UnboundedSequences[3] array_of_unbounded_sequences, "
     "test_msgs/msg/Arrays[<=3] bounded_sequence_of_arrays, "
     "test_msgs/msg/BoundedSequences[<=3] bounded_sequence_of_bounded_sequences, "
     "test_msgs/msg/UnboundedSequences[<=3] bounded_sequence_of_unbounded_sequences, "
     "test_msgs/msg/Arrays[] unbounded_sequence_of_arrays, "
     "test_msgs/msg/BoundedSequences[] unbounded_sequence_of_bounded_sequences, "
     "test_msgs/msg/UnboundedSequences[] unbounded_sequence_of_unbounded_sequences"},
    {"test_msgs/msg/Nested", "test_msgs/msg/BasicTypes basic_types_value"},
    {"test_msgs/msg/Strings",
     "string string_value, string string_value_default1, string string_value_default2, "
     "string string_value_default3, string string_value_default4, string string_value_default5, "
     "string<=22 bounded_string_value, string<=22 bounded_string_value_default1, "
     "string<=22 bounded_string_value_default2, string<=22 bounded_string_value_default3, "
     "string<=22 bounded_string_value_default4, string<=22 bounded_string_value_default5"},
    {"test_msgs/msg/UnboundedSequences",
     "bool[] bool_values, byte[] byte_values, uint8[] char_values, float32[] float32_values, "
     "float64[] float64_values, int8[] int8_values, uint8[] uint8_values, int16[] int16_values, "
     "uint16[] uint16_values, int32[] int32_values, uint32[] uint32_values, int64[] int64_values, "
     "uint64[] uint64_values, string[] string_values, "
     "test_msgs/msg/BasicTypes[] basic_types_values, test_msgs/msg/Constants[] constants_values, "
     "test_msgs/msg/Defaults[] defaults_values, bool[] bool_values_default, "
     "byte[] byte_values_default, uint8[] char_values_default, float32[] float32_values_default, "
     "float64[] float64_values_default, int8[] int8_values_default, uint8[] uint8_values_default, "
     "int16[] int16_values_default, uint16[] uint16_values_default, int32[] int32_values_default, "
     "uint32[] uint32_values_default, int64[] int64_values_default, "
     "uint64[] uint64_values_default, string[] string_values_default, int32 alignment_check"},
    {"test_msgs/msg/WStrings",
     "wstring wstring_value, wstring wstring_value_default1, wstring wstring_value_default2, "
     "wstring wstring_value_default3, wstring[3] array_of_wstrings, "
     "wstring[<=3] bounded_sequence_of_wstrings, wstring[] unbounded_sequence_of_wstrings"},
    {"test_msgs/srv/Arrays_Request",
     "bool[3] bool_values, byte[3] byte_values, uint8[3] char_values, float32[3] float32_values, "
     "float64[3] float64_values, int8[3] int8_values, uint8[3] uint8_values, "
     "int16[3] int16_values, uint16[3] uint16_values, int32[3] int32_values, "
     "uint32[3] uint32_values, int64[3] int64_values, uint64[3] uint64_values, "
     "string[3] string_values, test_msgs/msg/BasicTypes[3] basic_types_values, "
     "test_msgs/msg/Constants[3] constants_values, test_msgs/msg/Defaults[3] defaults_values, "
     "bool[3] bool_values_default, byte[3] byte_values_default, uint8[3] char_values_default, "
     "float32[3] float32_values_default, float64[3] float64_values_default, "
     "int8[3] int8_values_default, uint8[3] uint8_values_default, int16[3] int16_values_default, "
     "uint16[3] uint16_values_default, int32[3] int32_values_default, "
     "uint32[3] uint32_values_default, int64[3] int64_values_default, "
     "uint64[3] uint64_values_default, string[3] string_values_default"},
    {"test_msgs/srv/Arrays_Response",
     "bool[3] bool_values, byte[3] byte_values, uint8[3] char_values, float32[3] float32_values, "
     "float64[3] float64_values, int8[3] int8_values, uint8[3] uint8_values, "
     "int16[3] int16_values, uint16[3] uint16_values, int32[3] int32_values, "
     "uint32[3] uint32_values, int64[3] int64_values, uint64[3] uint64_values, "
     "string[3] string_values, test_msgs/msg/BasicTypes[3] basic_types_values, "
     "test_msgs/msg/Constants[3] constants_values, test_msgs/msg/Defaults[3] defaults_values, "
     "bool[3] bool_values_default, byte[3] byte_values_default, uint8[3] char_values_default, "
     "float32[3] float32_values_default, float64[3] float64_values_default, "
     "int8[3] int8_values_default, uint8[3] uint8_values_default, int16[3] int16_values_default, "
     "uint16[3] uint16_values_default, int32[3] int32_values_default, "
     "uint32[3] uint32_values_default, int64[3] int64_values_default, "
     "uint64[3] uint64_values_default, string[3] string_values_default"},
    {"test_msgs/srv/BasicTypes_Request",
     "bool bool_value, byte byte_value, uint8 char_value, float32 float32_value, "
     "float64 float64_value, int8 int8_value, uint8 uint8_value, int16 int16_value, "
     "uint16 uint16_value, int32 int32_value, uint32 uint32_value, int64 int64_value, "
     "uint64 uint64_value, string string_value"},
    {"test_msgs/srv/BasicTypes_Response",
     "bool bool_value, byte byte_value, uint8 char_value, float32 float32_value, "
     "float64 float64_value, int8 int8_value, uint8 uint8_value, int16 int16_value, "
     "uint16 uint16_value, int32 int32_value, uint32 uint32_value, int64 int64_value, "
     "uint64 uint64_value, string string_value"},
    {"test_msgs/srv/Empty_Request", "uint8 structure_needs_at_least_one_member"},
    {"test_msgs/srv/Empty_Response", "uint8 structure_needs_at_least_one_member"},
    {"test_msgs/action/Fibonacci_Goal", "int32 order"},
    {"test_msgs/action/Fibonacci_Result", "int32[] sequence"},
    {"test_msgs/action/Fibonacci_Feedback", "int32[] sequence"},
    {"test_msgs/action/Fibonacci_SendGoal_Request",
     "unique_identifier_msgs/msg/UUID goal_id, test_msgs/action/Fibonacci_Goal goal"},
    {"test_msgs/action/Fibonacci_SendGoal_Response",
     "bool accepted, builtin_interfaces/msg/Time stamp"},
    {"test_msgs/action/Fibonacci_GetResult_Request", "unique_identifier_msgs/msg/UUID goal_id"},
    {"test_msgs/action/Fibonacci_GetResult_Response",
     "int8 status, test_msgs/action/Fibonacci_Result result"},
    {"test_msgs/action/Fibonacci_FeedbackMessage",
     "unique_identifier_msgs/msg/UUID goal_id, test_msgs/action/Fibonacci_Feedback feedback"},
    {"test_msgs/action/NestedMessage_Goal",
     "test_msgs/msg/Builtins nested_field_no_pkg, test_msgs/msg/BasicTypes nested_field, "
     "builtin_interfaces/msg/Time nested_different_pkg"},
    {"test_msgs/action/NestedMessage_Result",
     "test_msgs/msg/Builtins nested_field_no_pkg, test_msgs/msg/BasicTypes nested_field, "
     "builtin_interfaces/msg/Time nested_different_pkg"},
    {"test_msgs/action/NestedMessage_Feedback",
     "test_msgs/msg/Builtins nested_field_no_pkg, test_msgs/msg/BasicTypes nested_field, "
     "builtin_interfaces/msg/Time nested_different_pkg"},
    {"test_msgs/action/NestedMessage_SendGoal_Request",
     "unique_identifier_msgs/msg/UUID goal_id, test_msgs/action/NestedMessage_Goal goal"},
    {"test_msgs/action/NestedMessage_SendGoal_Response",
     "bool accepted, builtin_interfaces/msg/Time stamp"},
    {"test_msgs/action/NestedMessage_GetResult_Request", "unique_identifier_msgs/msg/UUID goal_id"},
    {"test_msgs/action/NestedMessage_GetResult_Response",
     "int8 status, test_msgs/action/NestedMessage_Result result"},
    {"test_msgs/action/NestedMessage_FeedbackMessage",
     "unique_identifier_msgs/msg/UUID goal_id, test_msgs/action/NestedMessage_Feedback feedback"},
    {"tf2_msgs/msg/TF2Error", "uint8 error, string error_string"},
    {"tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped[] transforms"},
    {"tf2_msgs/srv/FrameGraph_Request", "uint8 structure_needs_at_least_one_member"},
    {"tf2_msgs/srv/FrameGraph_Response", "string frame_yaml"},
    {"tf2_msgs/action/LookupTransform_Goal",
     "string target_frame, string source_frame, builtin_interfaces/msg/Time source_time, "
     "builtin_interfaces/msg/Duration timeout, builtin_interfaces/msg/Time target_time, "
     "string fixed_frame, bool advanced"},
    {"tf2_msgs/action/LookupTransform_Result",
     "geometry_msgs/msg/TransformStamped transform, tf2_msgs/msg/TF2Error error"},
    {"tf2_msgs/action/LookupTransform_Feedback", "uint8 structure_needs_at_least_one_member"},
    {"tf2_msgs/action/LookupTransform_SendGoal_Request",
     "unique_identifier_msgs/msg/UUID goal_id, tf2_msgs/action/LookupTransform_Goal goal"},
    {"tf2_msgs/action/LookupTransform_SendGoal_Response",
     "bool accepted, builtin_interfaces/msg/Time stamp"},
    {"tf2_msgs/action/LookupTransform_GetResult_Request",
     "unique_identifier_msgs/msg/UUID goal_id"},
    {"tf2_msgs/action/LookupTransform_GetResult_Response",
     "int8 status, tf2_msgs/action/LookupTransform_Result result"},
    {"tf2_msgs/action/LookupTransform_FeedbackMessage",
     "unique_identifier_msgs/msg/UUID goal_id, tf2_msgs/action/LookupTransform_Feedback feedback"},
    {"trajectory_msgs/msg/JointTrajectory",
     "std_msgs/msg/Header header, string[] joint_names, "
     "trajectory_msgs/msg/JointTrajectoryPoint[] points"},
    {"trajectory_msgs/msg/JointTrajectoryPoint",
     "float64[] positions, float64[] velocities, float64[] accelerations, float64[] effort, "
     "builtin_interfaces/msg/Duration time_from_start"},
    {"trajectory_msgs/msg/MultiDOFJointTrajectory",
     "std_msgs/msg/Header header, string[] joint_names, "
     "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint[] points"},
    {"trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
     "geometry_msgs/msg/Transform[] transforms, geometry_msgs/msg/Twist[] velocities, "
     "geometry_msgs/msg/Twist[] accelerations, builtin_interfaces/msg/Duration time_from_start"},
    {"unique_identifier_msgs/msg/UUID", "uint8[16] uuid"},
    {"visualization_msgs/msg/ImageMarker",
     "std_msgs/msg/Header header, string ns, int32 id, int32 type, int32 action, "
     "geometry_msgs/msg/Point position, float32 scale, std_msgs/msg/ColorRGBA outline_color, "
     "uint8 filled, std_msgs/msg/ColorRGBA fill_color, builtin_interfaces/msg/Duration lifetime, "
     "geometry_msgs/msg/Point[] points, std_msgs/msg/ColorRGBA[] outline_colors"},
    {"visualization_msgs/msg/InteractiveMarker",
     "std_msgs/msg/Header header, geometry_msgs/msg/Pose pose, string name, string description, "
     "float32 scale, visualization_msgs/msg/MenuEntry[] menu_entries, "
     "visualization_msgs/msg/InteractiveMarkerControl[] controls"},
    {"visualization_msgs/msg/InteractiveMarkerControl",
     "string name, geometry_msgs/msg/Quaternion orientation, uint8 orientation_mode, "
     "uint8 interaction_mode, bool always_visible, visualization_msgs/msg/Marker[] markers, "
     "bool independent_marker_orientation, string description"},
    {"visualization_msgs/msg/InteractiveMarkerFeedback",
     "std_msgs/msg/Header header, string client_id, string marker_name, string control_name, "
     "uint8 event_type, geometry_msgs/msg/Pose pose, uint32 menu_entry_id, "
     "geometry_msgs/msg/Point mouse_point, bool mouse_point_valid"},
    {"visualization_msgs/msg/InteractiveMarkerInit",
     "string server_id, uint64 seq_num, visualization_msgs/msg/InteractiveMarker[] markers"},
    {"visualization_msgs/msg/InteractiveMarkerPose",
     "std_msgs/msg/Header header, geometry_msgs/msg/Pose pose, string name"},
    {"visualization_msgs/msg/InteractiveMarkerUpdate",
     "string server_id, uint64 seq_num, uint8 type, "
     "visualization_msgs/msg/InteractiveMarker[] markers, "
     "visualization_msgs/msg/InteractiveMarkerPose[] poses, string[] erases"},
    {"visualization_msgs/msg/Marker",
     "std_msgs/msg/Header header, string ns, int32 id, int32 type, int32 action, "
     "geometry_msgs/msg/Pose pose, geometry_msgs/msg/Vector3 scale, std_msgs/msg/ColorRGBA color, "
     "builtin_interfaces/msg/Duration lifetime, bool frame_locked, "
     "geometry_msgs/msg/Point[] points, std_msgs/msg/ColorRGBA[] colors, string texture_resource, "
     "sensor_msgs/msg/CompressedImage texture, "
     "visualization_msgs/msg/UVCoordinate[] uv_coordinates, string text, string mesh_resource, "
     "visualization_msgs/msg/MeshFile mesh_file, bool mesh_use_embedded_materials"},
    {"visualization_msgs/msg/MarkerArray", "visualization_msgs/msg/Marker[] markers"},
    {"visualization_msgs/msg/MenuEntry",
     "uint32 id, uint32 parent_id, string title, string command, uint8 command_type"},
    {"visualization_msgs/msg/MeshFile", "string filename, uint8[] data"},
    {"visualization_msgs/msg/UVCoordinate", "float32 u, float32 v"},
    {"visualization_msgs/srv/GetInteractiveMarkers_Request",
     "uint8 structure_needs_at_least_one_member"},
    {"visualization_msgs/srv/GetInteractiveMarkers_Response",
     "uint64 sequence_number, visualization_msgs/msg/InteractiveMarker[] markers"},
};

}  // namespace agnocast::test
