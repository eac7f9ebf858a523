// SPDX-License-Identifier: Apache-2.0

#include <bench/pipeline/simulator.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

namespace agnocast::bench::pipeline {
namespace {

constexpr double nothing = std::numeric_limits<double>::infinity();

/// The standard defines the output of mt19937_64, but not that of its distributions.
class Random {
 public:
  explicit Random(std::uint64_t seed) : words_(seed) {}
  double below(double bound) { return static_cast<double>(words_() >> 11) * 0x1p-53 * bound; }
  double between(double low, double high) { return low + below(high - low); }
  /// Returns a nearly normal number: the sum of four uniform ones, whose variance is 4/12.
  double normal(double deviation) {
    const double sum = below(1) + below(1) + below(1) + below(1) - 2;
    return sum * std::numbers::sqrt3 * deviation;
  }

 private:
  std::mt19937_64 words_;
};

struct Ray {
  Vector from, along;  // `along` has length 1
};

/// Returns the distance to where the ray enters the box. A ray that begins inside meets nothing:
/// no sensor is in a box.
double way_to(const Box& box, const Ray& ray) {
  double enter = 0, leave = nothing;
  const auto slab = [&](double low, double high, double from, double along) {
    // Along a side this divides by zero, and the infinities compare correctly.
    const double a = (low - from) / along, b = (high - from) / along;
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  };
  slab(box.low.x, box.high.x, ray.from.x, ray.along.x);
  slab(box.low.y, box.high.y, ray.from.y, ray.along.y);
  slab(box.low.z, box.high.z, ray.from.z, ray.along.z);
  return enter > 0 && enter <= leave ? enter : nothing;
}

struct Echo {
  double way = nothing;
  float reflectance = 0;

  void nearer(double other, float of) {
    if (other < way) *this = {other, of};
  }
};

/// Returns the first hit of the ray: on the vehicle in its frame, on the scene in the world's.
Echo cast(const Scene& scene, const Pose& vehicle, const Ray& ray) {
  Echo echo;
  echo.nearer(way_to(body, ray), 0.4f);
  for (const Box& mirror : mirrors) echo.nearer(way_to(mirror, ray), 0.9f);
  const Ray in_world{vehicle * ray.from, vehicle.rotation * ray.along};
  if (in_world.along.z < 0) echo.nearer(-in_world.from.z / in_world.along.z, 0.2f);
  for (const Solid& solid : scene) echo.nearer(way_to(solid.box, in_world), solid.reflectance);
  return echo;
}

Vector direction(double azimuth, double elevation) {
  return {std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
          std::sin(elevation)};
}

Solid standing(double x, double y, double length_x, double length_y, double height,
               double reflectance) {
  return {{{x - length_x / 2, y - length_y / 2, 0}, {x + length_x / 2, y + length_y / 2, height}},
          static_cast<float>(reflectance)};
}

}  // namespace

Scene make_scene(std::uint64_t seed) {
  Random random(seed);
  Scene scene;
  for (const double side : {-1.0, 1.0}) {
    for (double x = -100; x <= 100; x += 25) {
      scene.push_back(standing(x, side * 18, 20, 0.3, random.between(2.5, 4), 0.5));
      scene.push_back(standing(x + random.between(-4, 4), side * random.between(28, 34),
                               random.between(12, 20), random.between(8, 12), random.between(8, 25),
                               random.between(0.3, 0.7)));
      scene.push_back(standing(x + random.between(-8, 8), side * random.between(5, 8), 4.5, 1.8,
                               random.between(1.4, 2.2), random.between(0.1, 0.9)));
      scene.push_back(standing(x + 12, side * 11, 0.25, 0.25, 7, 0.6));
    }
  }
  return scene;
}

Cloud simulate(const Scene& scene, const Lidar& lidar, std::size_t number, const Noise& noise) {
  Random random(number * lidar_count + lidar.seed);
  const double revolution_s = std::chrono::duration<double>(revolution).count();
  const double time_before = static_cast<double>(number) * revolution_s;
  std_msgs::msg::Header header;
  header.frame_id = lidar.frame;
  Cloud cloud;
  begin_cloud(cloud, header, lidar.rings * lidar.columns);
  std::size_t count = 0;
  for (std::size_t column = 0; column < lidar.columns; ++column) {
    const double part = static_cast<double>(column) / static_cast<double>(lidar.columns);
    const Pose vehicle = pose_after(motion, time_before + part * revolution_s);
    const double azimuth = -2 * std::numbers::pi * part;  // clockwise, seen from above
    for (std::size_t ring = 0; ring < lidar.rings; ++ring) {
      const double elevation = lidar.lowest + (lidar.highest - lidar.lowest) *
                                                  static_cast<double>(ring) /
                                                  static_cast<double>(lidar.rings - 1);
      const Vector along = direction(azimuth, elevation);
      Echo echo =
          cast(scene, vehicle, {lidar.in_vehicle.position, lidar.in_vehicle.rotation * along});
      if (random.below(1) < noise.stray) echo.nearer(random.between(1, 15), 0.05f);
      if (echo.way > lidar.range_max_m || random.below(1) < noise.lost) continue;
      const double way = std::max(echo.way + random.normal(noise.range_m), 0.1);
      Point point;
      point.put(way * along);
      point.intensity = 255 * echo.reflectance / static_cast<float>(1 + way / 50);
      point.ring = static_cast<std::uint16_t>(ring);
      point.time_ns = static_cast<std::uint32_t>(
          part * static_cast<double>(std::chrono::nanoseconds(revolution).count()));
      set_point(cloud, count++, point);
    }
  }
  end_cloud(cloud, count);
  return cloud;
}

}  // namespace agnocast::bench::pipeline
