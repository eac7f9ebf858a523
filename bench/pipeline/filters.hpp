// SPDX-License-Identifier: Apache-2.0
//
// The nodes of the pipeline as functions from clouds to a cloud, which replaces the content of
// `out`. Each does the same as Autoware's node of that name; the code is ours.
#pragma once

#include <bench/pipeline/geometry.hpp>
#include <bench/pipeline/point.hpp>

#include <cstddef>
#include <span>

namespace agnocast::bench::pipeline {

/// Drops the points inside `box`, which is given in the vehicle's frame. Points stay in the
/// cloud's frame.
void crop_box(const Cloud& in, const Pose& in_vehicle, const Box& box, Cloud& out);

/// Moves every point to where a sensor that had not moved since the header's stamp would have
/// seen it. `twist` is the sensor's.
void correct_distortion(const Cloud& in, const Twist& twist, Cloud& out);

/// Limits for neighbours of a ring to form a group, and for a group to be an object.
struct RingOutlierLimits {
  double distance_ratio = 1.03;  ///< of two neighbours' distances from the sensor, at most
  double gap = radians(1);       ///< between two neighbours' directions, seen from above, at most
  std::size_t points = 4;        ///< a group of more points is an object
  double length_m = 0.1;         ///< or one with this distance from its first to its last point
};
/// Walks along each ring and drops groups that are no object: rain, dust, dirt on the sensor.
/// Orders the remaining points by ring.
void drop_ring_outliers(const Cloud& in, const RingOutlierLimits& limits, Cloud& out);

/// A cloud, and the pose of its sensor in the vehicle.
struct Part {
  const Cloud* cloud = nullptr;
  Pose in_vehicle;
};
/// Joins clouds to one in the vehicle's frame, "base_link", with the first part's stamp.
void concatenate(std::span<const Part> parts, Cloud& out);

}  // namespace agnocast::bench::pipeline
