// The contract of both nodes.
#pragma once

#include <agnocast/agnocast.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/string.hpp>

#include <cstdint>
#include <string>

using Cloud = sensor_msgs::msg::PointCloud2;
using Name = std_msgs::msg::String;

inline std::uint8_t byte_of(std::uint32_t cloud, std::size_t place) {
  return static_cast<std::uint8_t>(cloud * 31 + place * 7);
}
inline std::size_t bytes_of(std::uint32_t cloud) { return 1000 * cloud; }
inline std::string name_of(std::uint32_t cloud) {
  return "the cloud with the number " + std::to_string(cloud);
}
