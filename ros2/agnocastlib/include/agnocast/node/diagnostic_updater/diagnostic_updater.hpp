// SPDX-License-Identifier: Apache-2.0
//
// Diagnostics are those of the package diagnostic_updater, which must be linked: they travel as
// rclcpp's messages do.
#pragma once

#include <agnocast/node/agnocast_node.hpp>

#include <diagnostic_updater/diagnostic_updater.hpp>

namespace agnocast {

/// diagnostic_updater's, for an agnocast::Node, which must live longer.
class Updater : public diagnostic_updater::Updater {
 public:
  /// `period_s`: seconds between two updates.
  explicit Updater(Node& node, double period_s = 1.0)
      : diagnostic_updater::Updater(&node, period_s) {}
};

}  // namespace agnocast
