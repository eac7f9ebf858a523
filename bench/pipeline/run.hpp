// SPDX-License-Identifier: Apache-2.0
//
// A run of the pipeline: three processes with a LiDAR's filters each, one with concatenate, and
// this one, which releases frames at the sensors' rate. All edges exist all the time and
// alternate frame by frame, each first in every second round (A B B A), with the same scan in a
// round:
//
// - a disturbance of the machine longer than a frame affects both alike, unlike with blocks of
// frames;
// - a frame leaves nothing running for the next one: their distance is several times a frame's
// duration;
// - rounds are pairs, so the difference can be judged pair by pair.
//
// A frame that takes longer than the period delays the next one to a later beat, so frames never
// compete.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace agnocast::bench::pipeline {

struct Settings {
  std::vector<std::uint32_t> edges;  ///< indices in edges(), which alternate
  std::size_t rounds = 900;          ///< measured
  std::size_t warm_up = 10;          ///< before them, and not measured
  std::size_t inputs = 5;            ///< different scans
  std::chrono::nanoseconds period = std::chrono::milliseconds(100);
  std::string scan = {};
};

/// Times of one frame, in nanoseconds. The three parts add up to the response.
struct FrameTimes {
  double response = 0;  ///< from the top sensor's stamp to concatenate's output
  double compute = 0;   ///< processor time of the top chain and of concatenate
  double transfer = 0;  ///< from the top chain's output until concatenate has the same message
  double wait = 0;      ///< everything else: for the processor, for the other LiDARs
};

struct Measured {
  std::vector<std::vector<FrameTimes>> times;  ///< of each of Settings::edges, round by round
  std::uint64_t top_bytes = 0;                 ///< mean bytes of points that the top chain sends
  std::uint64_t points = 0;                    ///< mean number in concatenate's output
};

/// Throws std::runtime_error with the failure: an invalid scan, a process that ended, a message
/// that was lost or changed: every output must equal, byte for byte, the result of the nodes for
/// its input in one process.
Measured run(const Settings& settings,
             const std::function<void(std::size_t done, std::size_t all)>& progress);

}  // namespace agnocast::bench::pipeline
