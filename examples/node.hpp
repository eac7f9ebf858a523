// SPDX-License-Identifier: Apache-2.0
//
// The smallest thing that the library takes for a node.
#pragma once

#include <string>

namespace example {

struct Node {
  explicit Node(const char* node_name) : name(node_name) {}
  const char* get_name() const { return name.c_str(); }
  const char* get_namespace() const { return "/"; }
  std::string get_fully_qualified_name() const { return "/" + name; }
  std::string name;
};

}  // namespace example
