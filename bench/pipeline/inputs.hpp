// SPDX-License-Identifier: Apache-2.0
//
// The scans that a run repeats, and the expected outputs. Both are made before anything is
// measured.
#pragma once

#include <bench/pipeline/point.hpp>

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace agnocast::bench::pipeline {

/// Returns `count` consecutive simulated revolutions of one LiDAR. The top one repeats that of
/// the file `scan` instead, unless it is empty. Throws std::runtime_error if the file is not a
/// scan.
std::vector<Cloud> inputs_of(std::size_t lidar, std::size_t count, const std::string& scan);

/// Output of concatenate.
struct Output {
  std::uint64_t points = 0, checksum = 0;
  std::uint64_t top_bytes = 0;  ///< of points, in the top chain's message
};
/// Runs all nodes in this process, without any transport.
std::vector<Output> outputs_of(std::size_t count, const std::string& scan);

}  // namespace agnocast::bench::pipeline
