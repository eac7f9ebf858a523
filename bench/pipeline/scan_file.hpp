// SPDX-License-Identifier: Apache-2.0
//
// A recorded scan: five little-endian float32 for each point, x y z intensity ring, in the order in which they were
// measured; nothing before, between or behind them (the form of nuScenes). The form has no times, so the points are
// taken to be spread evenly over one revolution.
#pragma once

#include <bench/pipeline/point.hpp>

#include <string>

namespace agnocast::bench::pipeline {

/// Throws std::runtime_error: what is wrong, where in the file, and what to do.
Cloud read_scan(const std::string& path, const std::string& frame);

}  // namespace agnocast::bench::pipeline
