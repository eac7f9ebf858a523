// SPDX-License-Identifier: Apache-2.0
//
// Lane: a node of the bridge with a thread that runs its callbacks.
#pragma once

#include <agnocast/executor.hpp>
#include <agnocast/node.hpp>

#include <memory>
#include <string>
#include <vector>

namespace agnocast::bridge {

struct Lane {
  /// Throws Error: invalid_name, os_failure.
  explicit Lane(const std::string& name) : node(name) { executor.add_node(node); }

  Node node;
  BackgroundExecutor executor;
};

using Lanes = std::vector<std::unique_ptr<Lane>>;

}  // namespace agnocast::bridge
