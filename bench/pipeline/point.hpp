// SPDX-License-Identifier: Apache-2.0
//
// A point of the pipeline's clouds, and PointCloud2 as an array of them. Clouds are unordered
// (height 1), little-endian and dense; within a ring, points are in the order of measurement.
#pragma once

#include <bench/pipeline/geometry.hpp>

#include <sensor_msgs/msg/point_cloud2.hpp>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>

namespace agnocast::bench::pipeline {

using Cloud = sensor_msgs::msg::PointCloud2;

struct Point {
  float x = 0, y = 0, z = 0;   ///< metres, in the frame of the sensor as it was at `time_ns`
  float intensity = 0;         ///< 0 … 255
  std::uint16_t ring = 0;      ///< index of the sensor's laser
  std::uint16_t reserved = 0;  ///< so that every byte of a cloud is defined
  std::uint32_t time_ns = 0;   ///< since the header's stamp

  Vector place() const { return {x, y, z}; }
  void put(Vector at) {
    x = static_cast<float>(at.x);
    y = static_cast<float>(at.y);
    z = static_cast<float>(at.z);
  }
};
static_assert(sizeof(Point) == 24 && std::is_trivially_copyable_v<Point>);

inline constexpr std::uint32_t point_step = sizeof(Point);

inline Point point_at(const Cloud& cloud, std::size_t index) {
  Point point;
  std::memcpy(&point, cloud.data.data() + index * point_step, point_step);
  return point;
}
inline void set_point(Cloud& cloud, std::size_t index, const Point& point) {
  std::memcpy(cloud.data.data() + index * point_step, &point, point_step);
}

/// Sets the fields and makes room for `points`.
void begin_cloud(Cloud& cloud, const std_msgs::msg::Header& header, std::size_t points);
/// Sets the final number of points.
void end_cloud(Cloud& cloud, std::size_t points);

/// Returns whether a cloud has the form of end_cloud(): check every cloud of another process.
bool is_of_points(const Cloud& cloud);

/// Returns a checksum of everything in a cloud except its stamp.
std::uint64_t checksum_of(const Cloud& cloud);

}  // namespace agnocast::bench::pipeline
