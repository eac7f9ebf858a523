// SPDX-License-Identifier: Apache-2.0
//
// Introspection tables made at run time from the description of a type in a sample: for types
// whose package is not built here. Their messages have the layout of rosidl's C++ structs:
// std::string, std::vector, arrays in place.
#pragma once

#include <agnocast/generic.hpp>

#include <map>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::test {

/// Maps each type name to its fields, name and type, in order. Types as in .msg files, with the
/// full name of messages: "string<=6[<=4]", "std_msgs/msg/Header[2]".
using Schema = std::map<std::string, std::vector<std::pair<std::string, std::string>>>;

/// Returns the table of `type`, valid for ever; the same description gives the same table. Throws
/// std::runtime_error for an invalid description, or if there are too many. Not thread-safe.
const MessageMembers& members_of_schema(const Schema& schema, const std::string& type);

}  // namespace agnocast::test
