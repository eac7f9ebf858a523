// SPDX-License-Identifier: Apache-2.0
//
// A recorded scan: five little-endian float32 for each point, x y z intensity ring, in the order
// of measurement; nothing before, between or behind them (the format of nuScenes). It has no
// times, so the points are taken to be spread evenly over one revolution.
#pragma once

#include <bench/pipeline/point.hpp>

#include <string>

namespace agnocast::bench::pipeline {

/// Throws std::runtime_error with the error, its place in the file, and the remedy.
Cloud read_scan(const std::string& path, const std::string& frame);

}  // namespace agnocast::bench::pipeline
