// SPDX-License-Identifier: Apache-2.0
//
// Scans of an imaginary street: rays of a spinning sensor on the moving vehicle, against a ground
// plane, walls, houses, cars and poles. The sensor moves while it spins, so a scan is distorted
// as a real one. Everything follows from the seeds, identically in every process.
#pragma once

#include <bench/pipeline/geometry.hpp>
#include <bench/pipeline/point.hpp>
#include <bench/pipeline/vehicle.hpp>

#include <cstddef>
#include <cstdint>
#include <vector>

namespace agnocast::bench::pipeline {

struct Solid {
  Box box;
  float reflectance = 0;  ///< 0 … 1
};
/// In the world frame, whose ground is z = 0.
using Scene = std::vector<Solid>;
Scene make_scene(std::uint64_t seed);

struct Noise {
  double range_m = 0.02;  ///< standard deviation
  double lost = 0.02;     ///< fraction of the rays without an echo
  double stray = 0.001;   ///< fraction of the rays that end at a drop of rain
};
inline constexpr Noise no_noise{0, 0, 0};

/// Simulates the scan number `number`, one revolution long, with a stamp of 0.
Cloud simulate(const Scene& scene, const Lidar& lidar, std::size_t number, const Noise& noise);

}  // namespace agnocast::bench::pipeline
