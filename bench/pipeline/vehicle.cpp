// SPDX-License-Identifier: Apache-2.0

#include <bench/pipeline/vehicle.hpp>

namespace agnocast::bench::pipeline {

const std::array<Lidar, lidar_count>& lidars() {
  static const std::array<Lidar, lidar_count> all{{
      {.name = "top",
       .frame = "lidar_top",
       .in_vehicle = {{}, {1.0, 0, 2.1}},
       .rings = 128,
       .columns = 1800,
       .lowest = radians(-25),
       .highest = radians(15),
       .range_max_m = 120,
       .seed = 0},
      {.name = "left",
       .frame = "lidar_left",
       .in_vehicle = {turned(radians(90), radians(10)), {2.0, 1.15, 1.45}},
       .rings = 16,
       .columns = 600,
       .lowest = radians(-15),
       .highest = radians(15),
       .range_max_m = 60,
       .seed = 1},
      {.name = "right",
       .frame = "lidar_right",
       .in_vehicle = {turned(radians(-90), radians(10)), {2.0, -1.15, 1.45}},
       .rings = 16,
       .columns = 600,
       .lowest = radians(-15),
       .highest = radians(15),
       .range_max_m = 60,
       .seed = 2},
  }};
  return all;
}

void preprocess(const Lidar& lidar, const Cloud& scan, const std::function<Cloud&()>& output) {
  // Each node makes a message of its own, as a ROS 2 node does; within a process they are passed
  // on by pointer.
  Cloud without_self, without_mirrors, corrected;
  crop_box(scan, lidar.in_vehicle, self_crop, without_self);
  crop_box(without_self, lidar.in_vehicle, mirror_crop, without_mirrors);
  correct_distortion(without_mirrors, twist_at(lidar.in_vehicle, motion), corrected);
  drop_ring_outliers(corrected, {}, output());
}

}  // namespace agnocast::bench::pipeline
