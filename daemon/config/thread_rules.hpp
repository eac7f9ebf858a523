// SPDX-License-Identifier: Apache-2.0
//
// Thread rules: scheduling for the threads that run callbacks. Pure; the rules are the [[thread]]
// tables of the configuration in the order of the file.
//
// A rule names callback groups by process, node and group. A thread runs the groups of its
// executor: the first rule that matches one of them applies to the thread. It is applied only if
// the user of the process is in its list `users`.
#pragma once

#include <agnocast/abi/observe.hpp>
#include <daemon/config/access.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace agnocast::daemon {

struct ThreadRule {
  // Patterns; any when absent.
  std::optional<std::string> process;  // of the name of the program
  std::optional<std::string> node;     // of the fully qualified name
  std::optional<std::string> group;    // of the name of the callback group
  Principals users;
  abi::wire::ThreadScheduling scheduling{};
  std::string written_cpus;  // as in the file
  std::uint32_t line = 0;    // of the file, for people; no part of the rule's meaning

  friend bool operator==(const ThreadRule& a, const ThreadRule& b) noexcept;
};

/// A callback group and its process.
struct GroupNames {
  std::string_view process, node, group;
};

/// Returns the index of the first rule that matches; none: no rule does. Linear in their number.
std::optional<std::size_t> matching_rule(std::span<const ThreadRule> rules,
                                         const GroupNames& names) noexcept;

}  // namespace agnocast::daemon
