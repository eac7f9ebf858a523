// SPDX-License-Identifier: Apache-2.0
//
// Introspection tables made at run time from a description of a type, as samples of bytes carry it:
// for types whose package is not built here. Their messages are laid out as rosidl's C++ structs are:
// std::string, std::vector, arrays in place.
#pragma once

#include <agnocast/generic.hpp>

#include <map>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::test {

/// By the name of each type its fields, name and type, in order. Types as in .msg files, with the
/// whole name of messages: "string<=6[<=4]", "std_msgs/msg/Header[2]".
using Schema = std::map<std::string, std::vector<std::pair<std::string, std::string>>>;

/// The table of `type`; it stays as long as the process. The same description gives the same table.
/// Throws std::runtime_error if it is no description, or if there were too many. One thread.
const MessageMembers& members_of_schema(const Schema& schema, const std::string& type);

}  // namespace agnocast::test
