// SPDX-License-Identifier: Apache-2.0

#include <bench/pipeline/point.hpp>

#include <examples/demo/content.hpp>

#include <array>

namespace agnocast::bench::pipeline {
namespace {

using Field = sensor_msgs::msg::PointField;

struct FieldOfPoint {
  const char* name;
  std::size_t offset;
  std::uint8_t type;
};
constexpr std::array<FieldOfPoint, 6> fields_of_point{{
    {"x", offsetof(Point, x), Field::FLOAT32},
    {"y", offsetof(Point, y), Field::FLOAT32},
    {"z", offsetof(Point, z), Field::FLOAT32},
    {"intensity", offsetof(Point, intensity), Field::FLOAT32},
    {"ring", offsetof(Point, ring), Field::UINT16},
    {"time", offsetof(Point, time_ns), Field::UINT32},
}};

}  // namespace

void begin_cloud(Cloud& cloud, const std_msgs::msg::Header& header, std::size_t points) {
  cloud.header = header;
  cloud.fields.resize(fields_of_point.size());
  for (std::size_t i = 0; i < fields_of_point.size(); ++i) {
    cloud.fields[i].name = fields_of_point[i].name;
    cloud.fields[i].offset = static_cast<std::uint32_t>(fields_of_point[i].offset);
    cloud.fields[i].datatype = fields_of_point[i].type;
    cloud.fields[i].count = 1;
  }
  cloud.height = 1;
  cloud.is_bigendian = false;
  cloud.point_step = point_step;
  cloud.is_dense = true;
  cloud.data.resize(points * point_step);
}

void end_cloud(Cloud& cloud, std::size_t points) {
  cloud.data.resize(points * point_step);
  cloud.width = static_cast<std::uint32_t>(points);
  cloud.row_step = cloud.width * point_step;
}

bool is_of_points(const Cloud& cloud) {
  if (cloud.height != 1 || cloud.point_step != point_step || cloud.is_bigendian) return false;
  if (cloud.data.size() != std::size_t{cloud.width} * point_step) return false;
  if (cloud.fields.size() != fields_of_point.size()) return false;
  for (std::size_t i = 0; i < fields_of_point.size(); ++i) {
    const Field& field = cloud.fields[i];
    const FieldOfPoint& wanted = fields_of_point[i];
    if (field.name != wanted.name || field.offset != wanted.offset) return false;
    if (field.datatype != wanted.type || field.count != 1) return false;
  }
  return true;
}

std::uint64_t checksum_of(const Cloud& cloud) {
  demo::Checksum sum;
  sum.text(cloud.header.frame_id);
  sum.number(cloud.width);
  sum.number(cloud.fields.size());
  sum.bytes(cloud.data.data(), cloud.data.size());
  return sum.value();
}

}  // namespace agnocast::bench::pipeline
