// SPDX-License-Identifier: Apache-2.0
//
// Edge: the transport between a LiDAR's last filter and concatenate. On both ends a message is
// the same C++ object of rosidl's type; the transports differ. The topics are Autoware's.
//
//   cyclonedds-tuned   as in rmw_cyclonedds: written once into a sample, sent; received into one
//                      buffer, read from there into a new message
//   agnocast-executor  built in the shared heap, published, in the callback of an executor
#pragma once

#include <bench/pipeline/point.hpp>
#include <bench/pipeline/vehicle.hpp>

#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::bench::pipeline {

class CloudSender {
 public:
  virtual ~CloudSender() = default;
  virtual bool is_matched() = 0;
  /// Returns an empty message for the calling thread to fill.
  virtual Cloud& borrow() = 0;
  /// Sends the borrowed message. Throws std::runtime_error.
  virtual void send() = 0;
};

class CloudReceiver {
 public:
  /// The message is valid as long as it is held.
  using OnCloud = std::function<void(std::size_t lidar, std::shared_ptr<const Cloud>)>;
  virtual ~CloudReceiver() = default;
  /// Do not call it while run() runs.
  virtual bool is_matched() = 0;
  /// Calls back in the calling thread until stop(). Throws std::runtime_error.
  virtual void run() = 0;
  /// Any thread.
  virtual void stop() = 0;
};

struct Edge {
  std::string_view name;  ///< as in the results
  std::unique_ptr<CloudSender> (*make_sender)(const Lidar& lidar);
  std::unique_ptr<CloudReceiver> (*make_receiver)(CloudReceiver::OnCloud on_cloud);
};

/// Returns the edges of this build.
const std::vector<Edge>& edges();

inline std::string topic_of(const Lidar& lidar) {
  return std::string("/sensing/lidar/") + lidar.name + "/outlier_filtered/pointcloud";
}
/// One frame is in progress at a time; the rest is reserve for a busy machine.
inline constexpr std::size_t edge_depth = 5;

// One file each; the first may be absent.
extern const Edge cyclonedds_edge, agnocast_edge;
/// Returns the configuration of Cyclone DDS for all processes of one run: "CYCLONEDDS_URI=…".
std::string cyclonedds_variable();

}  // namespace agnocast::bench::pipeline
