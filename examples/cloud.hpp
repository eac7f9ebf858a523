// SPDX-License-Identifier: Apache-2.0
//
// A PointCloud2 whose every member follows from its number and, for a replayed scan, from the file; and
// the check that it does.
#pragma once

#include <sensor_msgs/msg/point_cloud2.hpp>

#include <cstdint>
#include <cstring>
#include <fstream>
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

/// A raw scan: 5 float32 per point. False if the file is not one.
inline bool read_scan(const std::string& path, std::vector<float>& values) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) return false;
  const auto bytes = file.tellg();
  if (bytes <= 0 || bytes % point_step != 0) return false;
  values.resize(static_cast<std::size_t>(bytes) / sizeof(float));
  file.seekg(0);
  return static_cast<bool>(file.read(reinterpret_cast<char*>(values.data()), bytes));
}

/// True when every member is what fill() made: of a replayed scan if `scan` is not empty.
inline bool check(const Cloud& cloud, std::uint64_t number, const std::vector<float>& scan) {
  if (cloud.header.frame_id != "lidar_top of cloud number " + std::to_string(number)) return false;
  if (cloud.header.stamp.sec != static_cast<std::int32_t>(number)) return false;
  if (cloud.header.stamp.nanosec != 0 || cloud.fields.size() != 5) return false;
  for (std::size_t i = 0; i < 5; ++i) {
    const auto& field = cloud.fields[i];
    if (field.name != field_names[i] || field.offset != i * sizeof(float)) return false;
    if (field.datatype != sensor_msgs::msg::PointField::FLOAT32 || field.count != 1) return false;
  }
  if (cloud.height != 1 || cloud.is_bigendian || !cloud.is_dense) return false;
  if (cloud.point_step != point_step || cloud.row_step != point_step * cloud.width) return false;
  if (cloud.data.size() != cloud.row_step) return false;
  if (!scan.empty())
    return cloud.data.size() == scan.size() * sizeof(float) &&
           std::memcmp(cloud.data.data(), scan.data(), cloud.data.size()) == 0;
  for (std::uint64_t i = 0; i < cloud.data.size() / sizeof(float); ++i) {
    float value = 0;
    std::memcpy(&value, cloud.data.data() + i * sizeof value, sizeof value);
    if (value != value_of(number, i)) return false;
  }
  return true;
}

}  // namespace example
