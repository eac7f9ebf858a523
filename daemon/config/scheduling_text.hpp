// SPDX-License-Identifier: Apache-2.0
//
// Scheduling as text: policies, durations and lists of processors, as thread rules write them.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/abi/observe.hpp>

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace agnocast::daemon {

inline constexpr std::string_view policy_names = "other, fifo, rr, batch, idle, deadline";

/// Returns SCHED_FIFO for "fifo"; nothing when the text is none of policy_names.
std::optional<std::uint32_t> policy_of(std::string_view name) noexcept;
/// Returns "fifo" for SCHED_FIFO; empty for a number that no name has.
std::string_view policy_name(std::uint32_t policy) noexcept;

/// Returns the nanoseconds of "5ms". Units: ns, us, ms, s. Nothing when the text is no duration, or
/// one of 2^63 ns or more, which sched_setattr(2) refuses.
std::optional<std::uint64_t> parse_duration(std::string_view text) noexcept;
/// Returns the shortest exact form: "5ms", "1500us", "7ns".
std::string duration_text(std::uint64_t nanoseconds);

/// Adds the processors of a list in the form of the kernel's files, "0-3,6", to `cpus`: one bit
/// each. Returns what is wrong with the list; nothing if it is right.
std::optional<std::string> read_cpu_list(std::string_view text,
                                         std::uint64_t (&cpus)[abi::cpu_count_max / 64]);

}  // namespace agnocast::daemon
