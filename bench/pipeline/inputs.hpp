// SPDX-License-Identifier: Apache-2.0
//
// The scans that a run repeats, and what has to come out of them. Both are made before anything is measured.
#pragma once

#include <bench/pipeline/point.hpp>

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace agnocast::bench::pipeline {

/// Of one LiDAR: `count` simulated revolutions in a row. The top one has that of the file `scan` instead, again and
/// again, unless it is empty. Throws std::runtime_error when the file is no scan.
std::vector<Cloud> inputs_of(std::size_t lidar, std::size_t count, const std::string& scan);

/// What concatenate makes of the inputs.
struct Output {
  std::uint64_t points = 0, checksum = 0;
  std::uint64_t top_bytes = 0;  ///< of points, in what the top chain sends
};
/// All nodes in this process, without any transport.
std::vector<Output> outputs_of(std::size_t count, const std::string& scan);

}  // namespace agnocast::bench::pipeline
