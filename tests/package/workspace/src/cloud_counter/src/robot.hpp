// The contract of both nodes.
#pragma once

#include <agnocast/agnocast.hpp>
#include <cloud_counter/msg/name.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>

#include <cstdint>
#include <string>

using Cloud = sensor_msgs::msg::PointCloud2;
using Name = cloud_counter::msg::Name;

inline std::uint8_t byte_of(std::uint32_t cloud, std::size_t place) {
  return static_cast<std::uint8_t>(cloud * 31 + place * 7);
}
inline std::size_t bytes_of(std::uint32_t cloud) { return 1000 * cloud; }
inline std::string name_of(std::uint32_t cloud) {
  return "the cloud with the number " + std::to_string(cloud);
}
