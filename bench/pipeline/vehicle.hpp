// SPDX-License-Identifier: Apache-2.0
//
// The vehicle of the pipeline: three LiDARs, the visible parts of the vehicle, its motion, and
// the processing of each scan.
//
// Its frame, base_link, is on the ground below the rear axle. The top sensor, on the roof, is of
// the class of 128 lasers; left and right, on the doors, of the class of 16.
#pragma once

#include <bench/pipeline/filters.hpp>
#include <bench/pipeline/geometry.hpp>
#include <bench/pipeline/point.hpp>

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>

namespace agnocast::bench::pipeline {

inline constexpr std::chrono::nanoseconds revolution = std::chrono::milliseconds(100);

struct Lidar {
  const char* name;   ///< "top"
  const char* frame;  ///< "lidar_top"
  Pose in_vehicle;
  std::size_t rings, columns;  ///< lasers, and firings of each in a revolution
  double lowest, highest;      ///< elevations of the outermost lasers
  double range_max_m;
  std::uint64_t seed;  ///< of its noise
};

inline constexpr std::size_t lidar_count = 3;
inline constexpr std::size_t top_lidar = 0;
const std::array<Lidar, lidar_count>& lidars();

/// Parts of the vehicle in sight: its body and its mirrors, and the boxes in which points are
/// dropped.
inline constexpr Box body{{-1.0, -0.95, 0.2}, {3.8, 0.95, 1.55}};
inline constexpr std::array<Box, 2> mirrors{{
    {{2.25, 0.95, 1.3}, {2.4, 1.2, 1.55}},
    {{2.25, -1.2, 1.3}, {2.4, -0.95, 1.55}},
}};
inline constexpr Box self_crop{{-1.15, -1.05, 0.1}, {3.95, 1.05, 1.7}};
inline constexpr Box mirror_crop{{2.1, -1.35, 1.15}, {2.55, 1.35, 1.7}};

/// 36 km/h in a long left turn.
inline constexpr Twist motion{{10, 0, 0}, {0, 0, 0.2}};

/// Runs the four nodes of one LiDAR. Calls `output` for the message of the last node when that
/// one begins.
void preprocess(const Lidar& lidar, const Cloud& scan, const std::function<Cloud&()>& output);

}  // namespace agnocast::bench::pipeline
