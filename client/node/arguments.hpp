// SPDX-License-Identifier: Apache-2.0
//
// ROS arguments of a command line, and what their remap rules make of names.
//
//   prog own args --ros-args -r from:=to -r node:from:=to -r __node:=name -r __ns:=/space -- own args
//
// Rules by kind: first the node's name, then its namespace (each by the first rule that applies),
// then topics and services: the first rule whose left side, expanded like any topic of the node, is
// the expanded name; its right side is expanded as well. Rules do not chain. With rostopic:// or
// rosservice:// in front of the left side it is for one of both. A rule with a node's name in front
// applies to nodes of that name alone (as it is after renaming, except for the rule that renames).
#pragma once

#include <agnocast/result.hpp>

#include <string>
#include <vector>

namespace agnocast {

struct RemapRule {
  enum class Kind { name, topic, service, node_name, node_namespace };  // name: topics and services
  Kind kind = Kind::name;
  std::string node;  // empty: of every node
  std::string from;  // topics and services only
  std::string to;
};

struct Arguments {
  std::vector<RemapRule> rules;
  std::vector<std::string> others;   // what is not for ROS, in order
  std::vector<std::string> ignored;  // what is for ROS and has no effect, with its value: "-p a:=1"
};

/// Parameters, enclaves and log options are accepted and have no effect. Errors: invalid_argument
/// (an option of --ros-args that is not known or has no value), invalid_name, each naming the
/// argument.
[[nodiscard]] Result<Arguments> parse_arguments(const std::vector<std::string>& arguments);

/// Those of the whole process: agnocast::init().
void set_global_arguments(Arguments arguments);
Arguments global_arguments();

/// The right side of the first rule of `kind` for the node `node`, or null.
const RemapRule* find_rule(const std::vector<RemapRule>& rules, RemapRule::Kind kind,
                           const std::string& node) noexcept;

/// `name`, fully qualified, of a topic or a service as the rules of its node name it. Errors:
/// invalid_name.
[[nodiscard]] Result<std::string> remap(const std::vector<RemapRule>& rules, RemapRule::Kind kind,
                                        const std::string& name, const std::string& node_name,
                                        const std::string& node_namespace);

}  // namespace agnocast
