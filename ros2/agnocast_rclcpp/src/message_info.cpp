// SPDX-License-Identifier: Apache-2.0

#include <agnocast_rclcpp/node_adapter.hpp>

#include <rmw/types.h>

#include <chrono>
#include <cstring>

namespace agnocast_rclcpp {

rclcpp::MessageInfo to_ros(const agnocast::MessageInfo& info) {
  using std::chrono::duration_cast;
  using std::chrono::nanoseconds;
  rmw_message_info_t ros = rmw_get_zero_initialized_message_info();
  ros.source_timestamp = static_cast<rmw_time_point_value_t>(info.source_timestamp());
  ros.received_timestamp =
      duration_cast<nanoseconds>(std::chrono::system_clock::now().time_since_epoch()).count();
  ros.publication_sequence_number = info.sequence;
  ros.reception_sequence_number = RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED;
  ros.publisher_gid.implementation_identifier = "agnocast";
  static_assert(sizeof ros.publisher_gid.data >= sizeof info.publisher);
  std::memcpy(ros.publisher_gid.data, &info.publisher, sizeof info.publisher);
  ros.from_intra_process = false;
  return rclcpp::MessageInfo(ros);
}

}  // namespace agnocast_rclcpp
