// SPDX-License-Identifier: Apache-2.0
//
// A PointCloud2 whose content follows from its number and, for a replayed scan, from the file;
// and a check of that content.
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
// x y z intensity ring, as in nuScenes; KITTI has no ring, other files have x y z only.
inline constexpr std::size_t fields_min = 3, fields_max = 5;

/// The points of a file: `fields` float32 each, the first of field_names.
struct Scan {
  std::vector<float> values;
  std::size_t fields = fields_max;
};

inline float value_of(std::uint64_t number, std::uint64_t i) {
  return static_cast<float>((number * 2654435761u + i * 40503u) % 1000003u) / 1000.0f;
}

/// Fills it in an arbitrary way: push_back, resize, assign and insert mixed, so that the vectors
/// reallocate as in real code.
inline void fill(Cloud& cloud, std::uint64_t number, std::uint64_t points, const Scan& scan) {
  const auto put = [&](float value) {
    unsigned char bytes[sizeof value];
    std::memcpy(bytes, &value, sizeof value);
    cloud.data.insert(cloud.data.end(), bytes, bytes + sizeof value);
  };
  cloud.header.frame_id.assign("lidar_top of cloud number ").append(std::to_string(number));
  cloud.header.stamp.sec = static_cast<std::int32_t>(number);
  if (scan.values.empty()) {
    const std::uint64_t values = points * scan.fields;
    cloud.data.reserve(number % 2 == 0 ? values * sizeof(float) : 0);
    for (std::uint64_t i = 0; i < values; ++i) put(value_of(number, i));
  } else {
    const auto* bytes = reinterpret_cast<const unsigned char*>(scan.values.data());
    cloud.data.assign(bytes, bytes + scan.values.size() * sizeof(float));
    points = scan.values.size() / scan.fields;
  }
  cloud.fields.resize(2);
  for (std::size_t i = 0; i < scan.fields; ++i) {
    if (i >= cloud.fields.size()) cloud.fields.emplace_back();
    cloud.fields[i].name = field_names[i];
    cloud.fields[i].offset = static_cast<std::uint32_t>(i * sizeof(float));
    cloud.fields[i].datatype = sensor_msgs::msg::PointField::FLOAT32;
    cloud.fields[i].count = 1;
  }
  cloud.height = 1;
  cloud.width = static_cast<std::uint32_t>(points);
  cloud.point_step = static_cast<std::uint32_t>(scan.fields * sizeof(float));
  cloud.row_step = cloud.point_step * cloud.width;
  cloud.is_dense = true;
}

/// Reads a raw scan. If `fields` is 0, the size of the file must show whether points have 4 or 5
/// fields. Returns an error, or an empty string.
inline std::string read_scan(const std::string& path, std::size_t fields, Scan& scan) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) return "cannot be read";
  const auto end = file.tellg();
  if (end <= 0) return "no points";
  const auto bytes = static_cast<std::size_t>(end);
  const auto fits = [&](std::size_t count) { return bytes % (count * sizeof(float)) == 0; };
  if (fields == 0 && fits(4) && fits(5))
    return "its size fits 4 and 5 float32 per point: give --fields 4 or --fields 5";
  if (fields == 0 && !fits(4) && !fits(5))
    return "not a scan of 4 or 5 float32 per point: x y z intensity [ring]";
  if (fields == 0) fields = fits(5) ? 5 : 4;
  if (!fits(fields)) return "not a scan of " + std::to_string(fields) + " float32 per point";
  scan.fields = fields;
  scan.values.resize(bytes / sizeof(float));
  file.seekg(0);
  return file.read(reinterpret_cast<char*>(scan.values.data()), end) ? "" : "cannot be read";
}

/// Returns whether every member equals the result of fill(), for a replayed scan if `scan` has
/// one.
inline bool check(const Cloud& cloud, std::uint64_t number, const Scan& scan) {
  if (cloud.header.frame_id != "lidar_top of cloud number " + std::to_string(number)) return false;
  if (cloud.header.stamp.sec != static_cast<std::int32_t>(number)) return false;
  if (cloud.header.stamp.nanosec != 0 || cloud.fields.size() != scan.fields) return false;
  for (std::size_t i = 0; i < scan.fields; ++i) {
    const auto& field = cloud.fields[i];
    if (field.name != field_names[i] || field.offset != i * sizeof(float)) return false;
    if (field.datatype != sensor_msgs::msg::PointField::FLOAT32 || field.count != 1) return false;
  }
  if (cloud.height != 1 || cloud.is_bigendian || !cloud.is_dense) return false;
  if (cloud.point_step != scan.fields * sizeof(float) ||
      cloud.row_step != cloud.point_step * cloud.width)
    return false;
  if (cloud.data.size() != cloud.row_step) return false;
  if (!scan.values.empty())
    return cloud.data.size() == scan.values.size() * sizeof(float) &&
           std::memcmp(cloud.data.data(), scan.values.data(), cloud.data.size()) == 0;
  for (std::uint64_t i = 0; i < cloud.data.size() / sizeof(float); ++i) {
    float value = 0;
    std::memcpy(&value, cloud.data.data() + i * sizeof value, sizeof value);
    if (value != value_of(number, i)) return false;
  }
  return true;
}

}  // namespace example
