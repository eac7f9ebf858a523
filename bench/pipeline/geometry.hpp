// SPDX-License-Identifier: Apache-2.0
//
// Rigid motions in three dimensions, as needed for a LiDAR on a vehicle. Frames are right-handed,
// x forward, y to the left, z up; metres, radians, seconds.
#pragma once

#include <cmath>
#include <numbers>

namespace agnocast::bench::pipeline {

struct Vector {
  double x = 0, y = 0, z = 0;
};
constexpr Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
constexpr Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
constexpr Vector operator*(double s, Vector a) { return {s * a.x, s * a.y, s * a.z}; }
constexpr double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
constexpr Vector cross(Vector a, Vector b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline double length(Vector a) { return std::sqrt(dot(a, a)); }

constexpr double radians(double degrees) { return degrees * std::numbers::pi / 180; }

/// A rotation, by its columns: the images of the axes.
struct Rotation {
  Vector x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1};

  constexpr Vector operator*(Vector a) const { return a.x * x + a.y * y + a.z * z; }
  constexpr Rotation operator*(const Rotation& other) const {
    return {*this * other.x, *this * other.y, *this * other.z};
  }
  constexpr Rotation inverse() const { return {{x.x, y.x, z.x}, {x.y, y.y, z.y}, {x.z, y.z, z.z}}; }
};

/// The pose of a frame in another one; transforms points from the first to the second.
struct Pose {
  Rotation rotation;
  Vector position;

  constexpr Vector operator*(Vector a) const { return rotation * a + position; }
  constexpr Pose operator*(const Pose& other) const {
    return {rotation * other.rotation, *this * other.position};
  }
};

/// Constant velocities of a frame, expressed in that frame.
struct Twist {
  Vector linear, angular;
};

/// Returns the pose of the frame after `seconds`, in the frame as it was: the exponential of the
/// twist (Rodrigues' formula for the rotation; its integral, times the linear velocity, for the
/// position).
inline Pose pose_after(const Twist& twist, double seconds) {
  const Vector turn = seconds * twist.angular;
  const double angle = length(turn);
  // sin(a)/a, (1 - cos(a))/a² and (a - sin(a))/a³; near 0 by their series, whose next terms are
  // below a double's precision.
  const bool is_small = angle < 1e-4;
  const double square = angle * angle;
  const double first = is_small ? 1 - square / 6 : std::sin(angle) / angle;
  const double second = is_small ? 0.5 - square / 24 : (1 - std::cos(angle)) / square;
  const double third = is_small ? 1.0 / 6 - square / 120 : (1 - first) / square;
  const auto rotated = [&](Vector a) {
    return a + first * cross(turn, a) + second * cross(turn, cross(turn, a));
  };
  const Vector way = seconds * twist.linear;
  return {{rotated({1, 0, 0}), rotated({0, 1, 0}), rotated({0, 0, 1})},
          way + second * cross(turn, way) + third * cross(turn, cross(turn, way))};
}

/// Returns the twist of a frame that is fixed at `pose` in a frame with this twist.
inline Twist twist_at(const Pose& pose, const Twist& twist) {
  const Rotation back = pose.rotation.inverse();
  return {back * (twist.linear + cross(twist.angular, pose.position)), back * twist.angular};
}

/// Returns a rotation about z by `yaw`, then about the new y by `pitch` (positive: the front goes
/// down).
inline Rotation turned(double yaw, double pitch) {
  const double cy = std::cos(yaw), sy = std::sin(yaw), cp = std::cos(pitch), sp = std::sin(pitch);
  return {{cy * cp, sy * cp, -sp}, {-sy, cy, 0}, {cy * sp, sy * sp, cp}};
}

/// A box with its sides along the axes.
struct Box {
  Vector low, high;

  constexpr bool contains(Vector a) const {
    return a.x >= low.x && a.x <= high.x && a.y >= low.y && a.y <= high.y && a.z >= low.z &&
           a.z <= high.z;
  }
};

}  // namespace agnocast::bench::pipeline
