// SPDX-License-Identifier: Apache-2.0
//
// ROS arguments of a command line, and how their remap rules change names.
//
//   prog own args --ros-args -r from:=to -r node:from:=to -r __node:=name -r __ns:=/space -- own
//   args
//
// Order of rules: first the node's name, then its namespace (each by the first rule that
// applies), then topics and services: the first rule whose left side, expanded like any topic of
// the node, equals the expanded name; its right side is expanded as well. Rules do not chain.
// rostopic:// or rosservice:// before the left side restricts a rule to topics or services. A
// rule with a node's name applies only to nodes of that name (the name after renaming, except for
// the rule that renames).
#pragma once

#include <agnocast/result.hpp>

#include <string>
#include <vector>

namespace agnocast {

struct RemapRule {
  enum class Kind { name, topic, service, node_name, node_namespace };  // name: topics and services
  Kind kind = Kind::name;
  std::string node;  // empty: for every node
  std::string from;  // topics and services only
  std::string to;
};

struct Arguments {
  std::vector<RemapRule> rules;
  std::vector<std::string> others;   // not for ROS, in order
  std::vector<std::string> ignored;  // for ROS but without effect, with the value: "-p a:=1"
};

/// Parses arguments; parameters, enclaves and log options are accepted without effect. Errors:
/// invalid_argument (an option of --ros-args that is unknown or has no value), invalid_name, each
/// naming the argument.
[[nodiscard]] Result<Arguments> parse_arguments(const std::vector<std::string>& arguments);

/// Set and return the arguments of the whole process: agnocast::init().
void set_global_arguments(Arguments arguments);
Arguments global_arguments();

/// Returns the first rule of `kind` for the node `node`, or null.
const RemapRule* find_rule(const std::vector<RemapRule>& rules, RemapRule::Kind kind,
                           const std::string& node) noexcept;

/// Applies the rules of a node to `name`, a fully qualified name of a topic or a service. Errors:
/// invalid_name.
[[nodiscard]] Result<std::string> remap(const std::vector<RemapRule>& rules, RemapRule::Kind kind,
                                        const std::string& name, const std::string& node_name,
                                        const std::string& node_namespace);

}  // namespace agnocast
