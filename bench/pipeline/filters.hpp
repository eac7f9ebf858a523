// SPDX-License-Identifier: Apache-2.0
//
// The nodes of the pipeline as functions from clouds to a cloud, which replaces what `out` was. What each does is what
// Autoware's node of that name does; the code is ours.
#pragma once

#include <bench/pipeline/geometry.hpp>
#include <bench/pipeline/point.hpp>

#include <cstddef>
#include <span>

namespace agnocast::bench::pipeline {

/// Drops the points that lie in `box`, which is told in another frame than the cloud's: the vehicle's. Points keep
/// their frame.
void crop_box(const Cloud& in, const Pose& in_vehicle, const Box& box, Cloud& out);

/// Moves every point to where a sensor that had not moved since the header's stamp would have seen it. `twist` is the
/// sensor's.
void correct_distortion(const Cloud& in, const Twist& twist, Cloud& out);

/// What makes neighbours of a ring belong together, and what makes a group of them an object.
struct RingOutlierLimits {
  double distance_ratio = 1.03;  ///< of two neighbours' distances from the sensor, at most
  double gap = radians(1);       ///< between two neighbours' directions, seen from above, at most
  std::size_t points = 4;        ///< a group of more is an object
  double length_m = 0.1;         ///< or one that reaches so far from its first to its last point
};
/// Walks along each ring and drops groups that are no object: rain, dust, dirt on the sensor. The points that remain
/// are ordered by ring.
void drop_ring_outliers(const Cloud& in, const RingOutlierLimits& limits, Cloud& out);

/// A cloud, and where the sensor that it is told by is in the vehicle.
struct Part {
  const Cloud* cloud = nullptr;
  Pose in_vehicle;
};
/// One cloud in the vehicle's frame, "base_link". Its stamp is the first part's.
void concatenate(std::span<const Part> parts, Cloud& out);

}  // namespace agnocast::bench::pipeline
