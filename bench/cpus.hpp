// SPDX-License-Identifier: Apache-2.0
//
// CPUs for pinning, of those that this process may use (taskset, cgroups): the first, and the
// next one that is not a thread of the same core, because two threads of a core slow each other
// down. If there is no other core, or /sys has no answer, the second CPU.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::bench {

struct Cpus {
  std::vector<int> usable;           ///< in order, at least one
  int first = 0, second = 0;         ///< the same if there is only one
  std::optional<bool> are_siblings;  ///< threads of one core; empty: unknown, or there is only one

  bool has_two() const noexcept { return first != second; }
};

/// `core_of` returns equal texts for threads of one core; empty: unknown.
Cpus choose_cpus(std::vector<int> usable,
                 const std::function<std::optional<std::string>(int cpu)>& core_of);

/// Returns the CPUs of this machine for this process as it was started. All processes of the
/// benchmark get the same, because they inherit the allowed set. Throws std::runtime_error.
const Cpus& cpus();
/// Pins the calling thread, and threads it starts from now on. Returns false with errno.
bool pin_to(int cpu) noexcept;

}  // namespace agnocast::bench
