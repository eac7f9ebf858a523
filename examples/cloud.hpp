// SPDX-License-Identifier: Apache-2.0
//
// A PointCloud2 whose every member follows from its number, and the check that it does.
#pragma once

#include <sensor_msgs/msg/point_cloud2.hpp>

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace example {

using Cloud = sensor_msgs::msg::PointCloud2;

inline constexpr const char* field_names[] = {"x", "y", "z", "intensity", "ring"};
inline constexpr std::uint32_t point_step = sizeof(float) * 5;

inline float value_of(std::uint64_t number, std::uint64_t i) { return static_cast<float>((number * 2654435761u + i * 40503u) % 1000003u) / 1000.0f; }

/// Fills in an order that nobody plans for: push_back, resize, assign and insert mixed, so that the vectors grow as they like.
inline void fill(Cloud& cloud, std::uint64_t number, std::uint64_t points, const std::vector<float>& scan) {
  const auto put = [&](float value) {
    unsigned char bytes[sizeof value];
    std::memcpy(bytes, &value, sizeof value);
    cloud.data.insert(cloud.data.end(), bytes, bytes + sizeof value);
  };
  cloud.header.frame_id.assign("lidar_top of cloud number ").append(std::to_string(number));
  cloud.header.stamp.sec = static_cast<std::int32_t>(number);
  if (scan.empty()) {
    const std::uint64_t values = points * 5;
    cloud.data.reserve(number % 2 == 0 ? values * sizeof(float) : 0);
    for (std::uint64_t i = 0; i < values; ++i) put(value_of(number, i));
  } else {
    const auto* bytes = reinterpret_cast<const unsigned char*>(scan.data());
    cloud.data.assign(bytes, bytes + scan.size() * sizeof(float));
    points = scan.size() / 5;
  }
  cloud.fields.resize(2);
  for (std::size_t i = 0; i < 5; ++i) {
    if (i >= cloud.fields.size()) cloud.fields.emplace_back();
    cloud.fields[i].name = field_names[i];
    cloud.fields[i].offset = static_cast<std::uint32_t>(i * sizeof(float));
    cloud.fields[i].datatype = sensor_msgs::msg::PointField::FLOAT32;
    cloud.fields[i].count = 1;
  }
  cloud.height = 1;
  cloud.width = static_cast<std::uint32_t>(points);
  cloud.point_step = point_step;
  cloud.row_step = point_step * cloud.width;
  cloud.is_dense = true;
}

/// True when every member is what fill() made. A replayed scan is compared with `scan` if it is given, else by its shape alone.
inline bool check(const Cloud& cloud, std::uint64_t number, bool replayed) {
  if (cloud.header.frame_id != "lidar_top of cloud number " + std::to_string(number)) return false;
  if (cloud.header.stamp.sec != static_cast<std::int32_t>(number) || cloud.fields.size() != 5) return false;
  for (std::size_t i = 0; i < 5; ++i) {
    const auto& field = cloud.fields[i];
    if (field.name != field_names[i] || field.offset != i * sizeof(float) || field.count != 1) return false;
  }
  if (cloud.point_step != point_step || cloud.row_step != point_step * cloud.width || cloud.data.size() != cloud.row_step) return false;
  if (replayed) return true;
  for (std::uint64_t i = 0; i < cloud.data.size() / sizeof(float); ++i) {
    float value = 0;
    std::memcpy(&value, cloud.data.data() + i * sizeof value, sizeof value);
    if (value != value_of(number, i)) return false;
  }
  return true;
}

}  // namespace example
