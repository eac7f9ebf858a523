// SPDX-License-Identifier: Apache-2.0

#include <bench/pipeline/filters.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <vector>

namespace agnocast::bench::pipeline {
namespace {

std::size_t count_of(const Cloud& cloud) { return cloud.width; }

/// Indices of points by ring; those of a ring in the cloud's order.
struct Rings {
  std::vector<std::uint32_t> indices;
  std::vector<std::size_t> ends;  // of each ring in `indices`
};
Rings rings_of(const Cloud& cloud) {
  const std::size_t count = count_of(cloud);
  std::vector<std::size_t> next;
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t ring = point_at(cloud, i).ring;
    if (ring >= next.size()) next.resize(ring + 1);
    ++next[ring];
  }
  Rings rings;
  rings.ends.resize(next.size());
  std::inclusive_scan(next.begin(), next.end(), rings.ends.begin());
  std::exclusive_scan(next.begin(), next.end(), next.begin(), std::size_t{0});
  rings.indices.resize(count);
  for (std::size_t i = 0; i < count; ++i)
    rings.indices[next[point_at(cloud, i).ring]++] = static_cast<std::uint32_t>(i);
  return rings;
}

/// A point with its distance, which is needed twice.
struct Measured {
  Point point;
  double distance;
};

class RingWalk {
 public:
  RingWalk(const RingOutlierLimits& limits, Cloud& out)
      : limits_(limits), tangent_(std::tan(limits.gap)), out_(out) {}

  void step(const Point& point) {
    const Measured now{point, length(point.place())};
    if (!group_.empty() && !belong_together(group_.back(), now)) end_group();
    group_.push_back(now);
  }
  void end_group() {
    if (is_object()) {
      for (const Measured& one : group_) set_point(out_, kept_++, one.point);
    }
    group_.clear();
  }
  std::size_t kept() const { return kept_; }

 private:
  bool belong_together(const Measured& a, const Measured& b) const {
    const auto [near, far] = std::minmax(a.distance, b.distance);
    if (far > near * limits_.distance_ratio) return false;
    // |a × b| = |a| |b| sin, a · b = |a| |b| cos: saves an arc tangent for each point.
    const Vector p = a.point.place(), q = b.point.place();
    const double sine = std::abs(p.x * q.y - p.y * q.x);
    const double cosine = p.x * q.x + p.y * q.y;
    return sine <= cosine * tangent_;
  }
  bool is_object() const {
    if (group_.size() > limits_.points) return true;
    if (group_.empty()) return false;
    const Vector way = group_.back().point.place() - group_.front().point.place();
    return length(way) >= limits_.length_m;
  }

  const RingOutlierLimits& limits_;
  const double tangent_;
  Cloud& out_;
  std::vector<Measured> group_;
  std::size_t kept_ = 0;
};

}  // namespace

void crop_box(const Cloud& in, const Pose& in_vehicle, const Box& box, Cloud& out) {
  begin_cloud(out, in.header, count_of(in));
  std::size_t kept = 0;
  for (std::size_t i = 0; i < count_of(in); ++i) {
    const Point point = point_at(in, i);
    if (!box.contains(in_vehicle * point.place())) set_point(out, kept++, point);
  }
  end_cloud(out, kept);
}

void correct_distortion(const Cloud& in, const Twist& twist, Cloud& out) {
  begin_cloud(out, in.header, count_of(in));
  // All lasers of a firing measure at the same time, and are consecutive in the cloud.
  std::uint32_t time_ns = 0;
  Pose sensor;
  for (std::size_t i = 0; i < count_of(in); ++i) {
    Point point = point_at(in, i);
    if (point.time_ns != time_ns) {
      time_ns = point.time_ns;
      sensor = pose_after(twist, time_ns * 1e-9);
    }
    point.put(sensor * point.place());
    set_point(out, i, point);
  }
  end_cloud(out, count_of(in));
}

void drop_ring_outliers(const Cloud& in, const RingOutlierLimits& limits, Cloud& out) {
  begin_cloud(out, in.header, count_of(in));
  const Rings rings = rings_of(in);
  RingWalk walk(limits, out);
  std::size_t at = 0;
  for (const std::size_t end : rings.ends) {
    for (; at < end; ++at) walk.step(point_at(in, rings.indices[at]));
    walk.end_group();
  }
  end_cloud(out, walk.kept());
}

void concatenate(std::span<const Part> parts, Cloud& out) {
  std::size_t points = 0;
  for (const Part& part : parts) points += count_of(*part.cloud);
  std_msgs::msg::Header header;
  if (!parts.empty()) header = parts.front().cloud->header;
  header.frame_id = "base_link";
  begin_cloud(out, header, points);
  std::size_t at = 0;
  for (const Part& part : parts) {
    for (std::size_t i = 0; i < count_of(*part.cloud); ++i) {
      Point point = point_at(*part.cloud, i);
      point.put(part.in_vehicle * point.place());
      set_point(out, at++, point);
    }
  }
  end_cloud(out, points);
}

}  // namespace agnocast::bench::pipeline
