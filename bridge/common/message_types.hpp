// SPDX-License-Identifier: Apache-2.0
//
// MessageTypes: the message types that the bridge can handle, found at run time. A missing type is
// searched again after a while. One thread, run()'s; any thread may use the types that it returns.
#pragma once

#include <agnocast/generic.hpp>
#include <bridge/cdr/cdr.hpp>
#include <bridge/common/linger.hpp>

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::bridge {

/// A message type, ready for both directions.
struct BridgedType {
  IntrospectedType introspected;
  CdrType cdr;
};

class MessageTypes {
 public:
  /// `paths`: see try_find_message_type().
  explicit MessageTypes(std::vector<std::string> paths) : paths_(std::move(paths)) {}

  /// Returns why messages of a ROS type are not available here; nothing if they are.
  std::optional<std::string> problem_of(const std::string& type);
  /// Returns a type that problem_of() has found.
  const std::shared_ptr<const BridgedType>& at(const std::string& type) const {
    return types_.at(type);
  }

 private:
  struct Missing {
    std::string why;
    Time since;
  };

  const std::vector<std::string> paths_;
  std::map<std::string, std::shared_ptr<const BridgedType>> types_;
  std::map<std::string, Missing> missing_;
};

}  // namespace agnocast::bridge
