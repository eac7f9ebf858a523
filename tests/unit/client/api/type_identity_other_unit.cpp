// SPDX-License-Identifier: Apache-2.0
//
// The other translation unit of type_identity_test.cpp. CMakeLists.txt sets its switches.

#include "tests/unit/client/api/type_identity_types.hpp"

#include <agnocast/rosidl.hpp>

#include <agnocast_test_msgs/msg/everything.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>

#if __cplusplus != 201703L
#error "this unit is there to be compiled as C++17"
#endif

namespace identity_test {

Hashes hashes_of_other_unit() {
  const auto pose = agnocast::message_type_of<Pose>();
  return {pose->layout_hash(), agnocast::message_type_of<Named>()->layout_hash(),
          agnocast::message_type_of<sensor_msgs::msg::PointCloud2>()->layout_hash(),
          agnocast::message_type_of<agnocast_test_msgs::msg::Everything>()->layout_hash(),
          std::string(pose->name())};
}

}  // namespace identity_test
