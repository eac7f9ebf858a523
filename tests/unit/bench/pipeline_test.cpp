// SPDX-License-Identifier: Apache-2.0
//
// Tests the nodes of the LiDAR pipeline with hand-made points whose results are known without the
// code under test, and with scans of a scene whose surfaces are known.

#include <bench/pipeline/filters.hpp>
#include <bench/pipeline/simulator.hpp>
#include <bench/pipeline/vehicle.hpp>

#include <gmock/gmock.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <initializer_list>
#include <vector>

namespace agnocast::bench::pipeline {
namespace {

using ::testing::ElementsAre;

Cloud cloud_of(const std::vector<Point>& points) {
  std_msgs::msg::Header header;
  header.frame_id = "lidar_top";
  header.stamp.sec = 7;
  Cloud cloud;
  begin_cloud(cloud, header, points.size());
  for (std::size_t i = 0; i < points.size(); ++i) set_point(cloud, i, points[i]);
  end_cloud(cloud, points.size());
  return cloud;
}
std::vector<Point> points_of(const Cloud& cloud) {
  EXPECT_TRUE(is_of_points(cloud));
  std::vector<Point> points;
  for (std::size_t i = 0; i < cloud.width; ++i) points.push_back(point_at(cloud, i));
  return points;
}
/// Points carry their names as intensities.
std::vector<int> names_in(const Cloud& cloud) {
  std::vector<int> names;
  for (const Point& point : points_of(cloud)) names.push_back(static_cast<int>(point.intensity));
  return names;
}
Point named(float name, double x, double y, double z) {
  Point point;
  point.put({x, y, z});
  point.intensity = name;
  return point;
}
/// At `azimuth_deg` and `distance` in the sensor's plane.
Point around(float name, double azimuth_deg, double distance, std::uint16_t ring = 0) {
  const double azimuth = radians(azimuth_deg);
  Point point = named(name, distance * std::cos(azimuth), distance * std::sin(azimuth), 0);
  point.ring = ring;
  return point;
}
testing::AssertionResult is_near(Vector a, Vector b, double tolerance) {
  const double distance = length(a - b);
  if (distance <= tolerance) return testing::AssertionSuccess();
  return testing::AssertionFailure() << a.x << ' ' << a.y << ' ' << a.z << " is " << distance
                                     << " m from " << b.x << ' ' << b.y << ' ' << b.z;
}

// --- a cloud

TEST(Cloud, IsKnownByItsFieldsAndSizes) {
  const Cloud good = cloud_of({named(1, 1, 2, 3)});
  EXPECT_TRUE(is_of_points(good));
  const auto is_good_after = [&](auto change) {
    Cloud cloud = good;
    change(cloud);
    return is_of_points(cloud);
  };
  EXPECT_FALSE(is_good_after([](Cloud& cloud) { cloud.width = 2; }));
  EXPECT_FALSE(is_good_after([](Cloud& cloud) { cloud.data.pop_back(); }));
  EXPECT_FALSE(is_good_after([](Cloud& cloud) { cloud.fields.pop_back(); }));
  EXPECT_FALSE(is_good_after([](Cloud& cloud) { std::swap(cloud.fields[0], cloud.fields[1]); }));
  EXPECT_FALSE(is_good_after([](Cloud& cloud) { cloud.point_step = 20; }));
}

TEST(Cloud, ChecksumSeesEveryByteAndNotTheStamp) {
  const Cloud cloud = cloud_of({named(1, 1, 2, 3), named(2, 4, 5, 6)});
  for (std::size_t byte = 0; byte < cloud.data.size(); ++byte) {
    Cloud other = cloud;
    other.data[byte] ^= 1;
    EXPECT_NE(checksum_of(other), checksum_of(cloud)) << byte;
  }
  Cloud later = cloud;
  later.header.stamp.sec += 1;
  EXPECT_EQ(checksum_of(later), checksum_of(cloud));
}

// --- crop box

TEST(CropBox, DropsPointsInsideTheBoxInTheVehiclesFrame) {
  // The sensor looks to the vehicle's left, 1 m above its origin: its x is the vehicle's y.
  const Pose sensor{turned(radians(90), 0), {0, 0, 1}};
  const Box box{{-1, 1, 0}, {1, 3, 2}};
  Cloud out;
  crop_box(cloud_of({named(1, 2, 0, 0),      // at (0, 2, 1) in the vehicle
                     named(2, 0, 2, 0),      // at (-2, 0, 1)
                     named(3, 2.9, 0.9, 0),  // at (-0.9, 2.9, 1)
                     named(4, 3.1, 0.9, 0),  // beyond the box in y
                     named(5, 2, 0, 1.1),    // above the box
                     named(6, 2, 0, -1.1)}),
           sensor, box, out);
  EXPECT_THAT(names_in(out), ElementsAre(2, 4, 5, 6));
  EXPECT_EQ(out.header.frame_id, "lidar_top");
  EXPECT_EQ(out.header.stamp.sec, 7);
}

TEST(CropBox, KeepsPointsAsTheyAre) {
  Point point = named(1, 5, 6, 7);
  point.ring = 9;
  point.time_ns = 12345;
  Cloud out;
  crop_box(cloud_of({point}), {turned(1, 0.2), {1, 2, 3}}, {{-1, -1, -1}, {1, 1, 1}}, out);
  ASSERT_EQ(out.width, 1u);
  const Point kept = point_at(out, 0);
  EXPECT_TRUE(is_near(kept.place(), {5, 6, 7}, 0));
  EXPECT_EQ(kept.ring, 9);
  EXPECT_EQ(kept.time_ns, 12345u);
}

TEST(CropBox, ReplacesTheOldOutput) {
  Cloud out = cloud_of({named(1, 9, 9, 9), named(2, 9, 9, 9)});
  crop_box(cloud_of({}), {}, {}, out);
  EXPECT_TRUE(points_of(out).empty());
}

// --- distortion corrector

TEST(DistortionCorrector, MovesPointsAlongAStraightPath) {
  // 10 m/s forward: a point seen after 50 ms at x = 3 was at x = 3.5 in the frame of the stamp.
  Point early = named(1, 3, 1, 0), late = early;
  late.time_ns = 50'000'000;
  Cloud out;
  correct_distortion(cloud_of({early, late}), {{10, 0, 0}, {}}, out);
  EXPECT_TRUE(is_near(point_at(out, 0).place(), {3, 1, 0}, 1e-6));
  EXPECT_TRUE(is_near(point_at(out, 1).place(), {3.5, 1, 0}, 1e-6));
  EXPECT_EQ(point_at(out, 1).time_ns, 50'000'000u);
}

TEST(DistortionCorrector, MovesPointsAlongACircle) {
  // A quarter of a circle of 2 m in 100 ms: the sensor ends at (2, 2), looking along y.
  const double rate = std::numbers::pi / 2 / 0.1;
  Point point = named(1, 1, 0, 4);
  point.time_ns = 100'000'000;
  Cloud out;
  correct_distortion(cloud_of({point}), {{2 * rate, 0, 0}, {0, 0, rate}}, out);
  EXPECT_TRUE(is_near(point_at(out, 0).place(), {2, 3, 4}, 1e-5));
}

TEST(DistortionCorrector, AgreesWithTheSeriesForSmallAngles) {
  // The motion is continuous where the formula changes.
  const Twist twist{{1, 2, 3}, {0.1, -0.2, 0.3}};
  const double border = 1e-4 / length(twist.angular);
  const Vector below = pose_after(twist, border * (1 - 1e-9)) * Vector{1, 1, 1};
  const Vector above = pose_after(twist, border * (1 + 1e-9)) * Vector{1, 1, 1};
  EXPECT_TRUE(is_near(below, above, 1e-11));
}

TEST(DistortionCorrector, AgreesWithManySmallSteps) {
  const Twist twist{{8, -1, 0.5}, {0.3, -0.4, 1.2}};
  constexpr int steps = 100'000;
  Pose pose;
  for (int i = 0; i < steps; ++i) pose = pose * pose_after(twist, 0.1 / steps);
  const Vector far{30, 20, 2};
  EXPECT_TRUE(is_near(pose_after(twist, 0.1) * far, pose * far, 1e-6));
}

// --- ring outlier filter

TEST(RingOutlierFilter, DropsALonePointAndKeepsTheWallBehind) {
  std::vector<Point> points;
  for (int i = 0; i < 10; ++i) points.push_back(around(static_cast<float>(i), -i * 0.2, 10));
  points[5] = around(5, -5 * 0.2, 3);  // a raindrop
  Cloud out;
  drop_ring_outliers(cloud_of(points), {}, out);
  EXPECT_THAT(names_in(out), ElementsAre(0, 1, 2, 3, 4, 6, 7, 8, 9));
}

TEST(RingOutlierFilter, KeepsASmallClusterOfManyPointsAndAWideOneOfFew) {
  std::vector<Point> points;
  // Five points within 1 cm, then two that are 0.17 m apart, then two that are 2 cm apart.
  for (int i = 0; i < 5; ++i) points.push_back(around(static_cast<float>(i), -i * 0.02, 5));
  points.push_back(around(10, -3, 10));
  points.push_back(around(11, -3.97, 10));
  points.push_back(around(20, -8, 10));
  points.push_back(around(21, -8.1, 10));
  Cloud out;
  drop_ring_outliers(cloud_of(points), {}, out);
  EXPECT_THAT(names_in(out), ElementsAre(0, 1, 2, 3, 4, 10, 11));
}

TEST(RingOutlierFilter, DividesAtAGapAndAtAJumpInDistance) {
  // Points of a pair form one object, or no object if they are divided.
  Cloud out;
  drop_ring_outliers(cloud_of({around(1, 0, 10), around(2, -1.1, 10)}), {}, out);
  EXPECT_THAT(names_in(out), ElementsAre());
  drop_ring_outliers(cloud_of({around(1, 0, 10), around(2, -0.9, 10)}), {}, out);
  EXPECT_THAT(names_in(out), ElementsAre(1, 2));
  drop_ring_outliers(cloud_of({around(1, 0, 10), around(2, -0.9, 10.31)}), {}, out);
  EXPECT_THAT(names_in(out), ElementsAre());
  drop_ring_outliers(cloud_of({around(1, 0, 10), around(2, -0.9, 10.29)}), {}, out);
  EXPECT_THAT(names_in(out), ElementsAre(1, 2));
  // Opposite directions also have a sine of zero.
  drop_ring_outliers(cloud_of({around(1, 0, 10), around(2, 180, 10)}), {}, out);
  EXPECT_THAT(names_in(out), ElementsAre());
}

TEST(RingOutlierFilter, FiltersEachRingSeparately) {
  // Two rings measured alternately; the third, nearest one has a lone point.
  std::vector<Point> points;
  for (int i = 0; i < 6; ++i) {
    points.push_back(around(static_cast<float>(10 + i), -i * 0.2, 10, 1));
    if (i == 2) points.push_back(around(1, -i * 0.2, 5, 0));
    points.push_back(around(static_cast<float>(20 + i), -i * 0.2, 20, 2));
  }
  Cloud out;
  drop_ring_outliers(cloud_of(points), {}, out);
  EXPECT_THAT(names_in(out), ElementsAre(10, 11, 12, 13, 14, 15, 20, 21, 22, 23, 24, 25));
}

// --- concatenate

TEST(Concatenate, TransformsAllPartsIntoTheVehiclesFrame) {
  const Cloud ahead = cloud_of({named(1, 1, 0, 0)});
  const Cloud none = cloud_of({});
  const Cloud aside = cloud_of({named(2, 1, 0, 0), named(3, 2, 0, 0)});
  const std::vector<Part> parts{
      {&ahead, {{}, {0, 0, 2}}}, {&none, {}}, {&aside, {turned(radians(-90), 0), {0, -1, 1}}}};
  Cloud out;
  concatenate(parts, out);
  EXPECT_THAT(names_in(out), ElementsAre(1, 2, 3));
  EXPECT_TRUE(is_near(point_at(out, 0).place(), {1, 0, 2}, 1e-6));
  EXPECT_TRUE(is_near(point_at(out, 1).place(), {0, -2, 1}, 1e-6));
  EXPECT_TRUE(is_near(point_at(out, 2).place(), {0, -3, 1}, 1e-6));
  EXPECT_EQ(out.header.frame_id, "base_link");
  EXPECT_EQ(out.header.stamp.sec, 7);
}

// --- simulator

TEST(Simulator, GivesTheSameScanAgainAndAnotherOneNext) {
  const Scene scene = make_scene(1);
  const Lidar& left = lidars()[1];
  const Cloud first = simulate(scene, left, 3, {});
  EXPECT_EQ(first, simulate(make_scene(1), left, 3, {}));
  EXPECT_NE(first.data, simulate(scene, left, 4, {}).data);
  EXPECT_NE(first.data, simulate(make_scene(2), left, 3, {}).data);
  EXPECT_NE(first.data, simulate(scene, lidars()[2], 3, {}).data);
}

TEST(Simulator, HasTheSizesOfThePipeline) {
  const Scene scene = make_scene(1);
  for (const Lidar& lidar : lidars()) {
    const Cloud scan = simulate(scene, lidar, 0, {});
    const Cloud again = simulate(scene, lidar, 1, {});
    Cloud out;
    preprocess(lidar, scan, [&]() -> Cloud& { return out; });
    for (const Cloud* const cloud : {&scan, &again, static_cast<const Cloud*>(&out)}) {
      if (&lidar == &lidars()[top_lidar]) {
        EXPECT_GT(cloud->data.size(), 2'000'000u);
        EXPECT_LT(cloud->data.size(), 6'000'000u);
      } else {
        EXPECT_GT(cloud->data.size(), 30'000u) << lidar.name;
        EXPECT_LT(cloud->data.size(), 300'000u) << lidar.name;
      }
    }
  }
}

/// Returns the distance of the point to the nearest surface of the scene.
double way_to_scene(const Scene& scene, Vector at) {
  double least = std::abs(at.z);
  for (const auto& [box, reflectance] : scene) {
    const auto beyond = [](double low, double value, double high) {
      return std::max(low - value, value - high);
    };
    const Vector out{beyond(box.low.x, at.x, box.high.x), beyond(box.low.y, at.y, box.high.y),
                     beyond(box.low.z, at.z, box.high.z)};
    const Vector outside{std::max(out.x, 0.0), std::max(out.y, 0.0), std::max(out.z, 0.0)};
    const double inside = std::min(std::max({out.x, out.y, out.z}), 0.0);
    least = std::min(least, std::abs(length(outside) + inside));
  }
  return least;
}

// The simulator moves the vehicle while the sensor spins. Without noise, all points left by the
// crop boxes lie on surfaces of the scene at the scan's first pose, but only after correction.
TEST(Simulator, DistortsAScanAsTheCorrectorUndoes) {
  const Scene scene = make_scene(1);
  constexpr std::size_t number = 2;
  const Pose vehicle =
      pose_after(motion, number * std::chrono::duration<double>(revolution).count());
  for (const Lidar& lidar : lidars()) {
    Cloud cropped, corrected;
    const Cloud scan = simulate(scene, lidar, number, no_noise);
    crop_box(scan, lidar.in_vehicle, self_crop, cropped);
    crop_box(cropped, lidar.in_vehicle, mirror_crop, corrected);
    std::swap(cropped, corrected);
    EXPECT_LT(cropped.width, scan.width) << lidar.name;
    const auto farthest = [&](const Cloud& cloud) {
      double most = 0;
      for (std::size_t i = 0; i < cloud.width; i += 7) {
        const Vector at = vehicle * (lidar.in_vehicle * point_at(cloud, i).place());
        most = std::max(most, way_to_scene(scene, at));
      }
      return most;
    };
    EXPECT_GT(farthest(cropped), 0.2) << lidar.name;
    correct_distortion(cropped, twist_at(lidar.in_vehicle, motion), corrected);
    EXPECT_LT(farthest(corrected), 1e-3) << lidar.name;
  }
}

TEST(Simulator, SeesItsOwnVehicleWhichTheCropBoxesRemove) {
  const Scene scene = make_scene(1);
  for (const Lidar& lidar : lidars()) {
    const Cloud scan = simulate(scene, lidar, 0, {});
    Cloud without_self, without_mirrors;
    crop_box(scan, lidar.in_vehicle, self_crop, without_self);
    crop_box(without_self, lidar.in_vehicle, mirror_crop, without_mirrors);
    EXPECT_LT(without_self.width, scan.width) << lidar.name;
    EXPECT_GT(without_mirrors.width, scan.width / 3) << lidar.name;
    if (&lidar != &lidars()[top_lidar]) {
      EXPECT_LT(without_mirrors.width, without_self.width) << lidar.name;
    }
  }
}

}  // namespace
}  // namespace agnocast::bench::pipeline
