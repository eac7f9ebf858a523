// SPDX-License-Identifier: Apache-2.0

#include <bench/pipeline/scan_file.hpp>

#include <bench/pipeline/vehicle.hpp>

#include <array>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <vector>

namespace agnocast::bench::pipeline {
namespace {

using Record = std::array<float, 5>;
// More than any sensor's revolution; refuses a recording of many scans before it allocates memory
// for it.
constexpr std::streamoff points_max = 4'000'000;
constexpr float rings_max = 1024;

[[noreturn]] void refuse(const std::string& path, const std::string& what) {
  throw std::runtime_error("the scan " + path + ": " + what);
}
[[noreturn]] void refuse_form(const std::string& path, const std::string& what) {
  refuse(path,
         what + "; give a file of one revolution, five float32 (x y z intensity ring) a point");
}

std::string place_of(std::size_t point) {
  return "point " + std::to_string(point) + ", at byte " + std::to_string(point * sizeof(Record)) +
         ", ";
}

std::vector<Record> records_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file)
    refuse(path, std::string("cannot be opened: ") + std::strerror(errno) + "; name another file");
  if (std::error_code ignored; !std::filesystem::is_regular_file(path, ignored))
    refuse_form(path, "it is no regular file");
  const std::streamoff bytes = file.tellg();
  constexpr std::streamoff record_bytes = sizeof(Record);
  if (bytes == 0) refuse_form(path, "it is empty");
  if (const std::streamoff rest = bytes % record_bytes; rest != 0) {
    refuse_form(path, "its last point, at byte " + std::to_string(bytes - rest) + ", has " +
                          std::to_string(rest) + " of " + std::to_string(record_bytes) + " bytes");
  }
  if (bytes / record_bytes > points_max) {
    refuse_form(path, "it has " + std::to_string(bytes / record_bytes) + " points, more than " +
                          std::to_string(points_max));
  }
  std::vector<Record> records(static_cast<std::size_t>(bytes / record_bytes));
  file.seekg(0);
  if (!file.read(reinterpret_cast<char*>(records.data()), bytes))
    refuse(path, "cannot be read to its end; check the disk, or copy the file again");
  return records;
}

}  // namespace

Cloud read_scan(const std::string& path, const std::string& frame) {
  const std::vector<Record> records = records_of(path);
  std_msgs::msg::Header header;
  header.frame_id = frame;
  Cloud cloud;
  begin_cloud(cloud, header, records.size());
  const auto revolution_ns =
      static_cast<std::uint64_t>(std::chrono::nanoseconds(revolution).count());
  for (std::size_t i = 0; i < records.size(); ++i) {
    const auto [x, y, z, intensity, ring] = records[i];
    if (!std::isfinite(x) || !std::isfinite(y) || !std::isfinite(z) || !std::isfinite(intensity))
      refuse_form(path, place_of(i) + "has a value that is no number");
    if (!(ring >= 0 && ring < rings_max) || ring != std::floor(ring))
      refuse_form(path, place_of(i) + "has the ring " + std::to_string(ring));
    Point point{.x = x, .y = y, .z = z, .intensity = intensity};
    point.ring = static_cast<std::uint16_t>(ring);
    point.time_ns = static_cast<std::uint32_t>(i * revolution_ns / records.size());
    set_point(cloud, i, point);
  }
  end_cloud(cloud, records.size());
  return cloud;
}

}  // namespace agnocast::bench::pipeline
