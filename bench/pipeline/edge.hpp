// SPDX-License-Identifier: Apache-2.0
//
// Edge: what is between a LiDAR's last filter and concatenate. On both ends a message is the same C++ object of
// rosidl's type; what differs is how it gets there. The topics are Autoware's.
//
//   cyclonedds-tuned   as rmw_cyclonedds does it: written once into a sample, sent; received into one buffer, read
//                      from there into a new message
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
  /// An empty message, to be filled by the calling thread.
  virtual Cloud& borrow() = 0;
  /// Sends what was borrowed. Throws std::runtime_error.
  virtual void send() = 0;
};

class CloudReceiver {
 public:
  /// The message is good as long as it is kept.
  using OnCloud = std::function<void(std::size_t lidar, std::shared_ptr<const Cloud>)>;
  virtual ~CloudReceiver() = default;
  /// Not while it runs.
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

/// The one without which this build does is left out.
const std::vector<Edge>& edges();

inline std::string topic_of(const Lidar& lidar) {
  return std::string("/sensing/lidar/") + lidar.name + "/outlier_filtered/pointcloud";
}
/// One frame is under way at a time; more than that is room for a machine that is busy.
inline constexpr std::size_t edge_depth = 5;

// One file each; the first may be absent.
extern const Edge cyclonedds_edge, agnocast_edge;
/// What Cyclone DDS reads in all processes of one run: "CYCLONEDDS_URI=…".
std::string cyclonedds_variable();

}  // namespace agnocast::bench::pipeline
