// SPDX-License-Identifier: Apache-2.0
//
// A run of the pipeline: three processes with a LiDAR's filters each, one with concatenate, and this one, which lets
// frames go at the sensors' rate. All edges are there all the time and take turns frame by frame, each before the
// other in every second round (A B B A), with the same scan in a round:
//
// - what disturbs the machine for longer than a frame disturbs both alike, which blocks of frames would not give;
// - a frame leaves nothing running for the next one, as they are several times longer apart than one takes;
// - rounds are pairs, so the difference can be judged pair by pair.
//
// A frame that takes longer than the period delays the next one to a later beat of it, so frames never compete.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace agnocast::bench::pipeline {

struct Settings {
  std::vector<std::uint32_t> edges;  ///< indices in edges(), which take turns
  std::size_t rounds = 900;          ///< kept
  std::size_t warm_up = 10;          ///< before them, and not kept
  std::size_t inputs = 5;            ///< different scans
  std::chrono::nanoseconds period = std::chrono::milliseconds(100);
  std::string scan = {};
};

/// Of one frame, in nanoseconds. The three parts are the response.
struct FrameTimes {
  double response = 0;  ///< from the top sensor's stamp to concatenate's output
  double compute = 0;   ///< processor time of the top chain and of concatenate
  double transfer = 0;  ///< from the top chain's output to the same message in concatenate's hands
  double wait = 0;      ///< everything else: for the processor, for the other LiDARs
};

struct Measured {
  std::vector<std::vector<FrameTimes>> times;  ///< of each of Settings::edges, round by round
  std::uint64_t top_bytes = 0;                 ///< of points, that the top chain sends in the mean
  std::uint64_t points = 0;                    ///< in concatenate's output, in the mean
};

/// Throws std::runtime_error with what went wrong: a scan that is none, a process that ended, a message that was lost
/// or changed: every output has to be, byte for byte, what the nodes make of its input in one process.
Measured run(const Settings& settings,
             const std::function<void(std::size_t done, std::size_t all)>& progress);

}  // namespace agnocast::bench::pipeline
