// SPDX-License-Identifier: Apache-2.0
//
// CPUs: those that runs are pinned to, of those that this process may use (taskset, cgroups): the first, and the next one
// that is not a thread of the same core, as two threads of a core slow each other down. Where there is no other core, or
// nobody tells (/sys), the second CPU.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace agnocast::bench {

struct Cpus {
  std::vector<int> usable;    ///< in order, at least one
  int first = 0, second = 0;  ///< the same where there is but one
  std::optional<bool>
      are_siblings;  ///< threads of one core; empty: nobody tells, or there is but one

  bool has_two() const noexcept { return first != second; }
};

/// `core_of` says the same of two CPUs where they are threads of one core; empty: it does not know.
Cpus choose_cpus(std::vector<int> usable,
                 const std::function<std::optional<std::string>(int cpu)>& core_of);

/// Of this machine, for this process as it was started. All processes of the benchmark find the same, as they inherit what
/// they may use. Throws std::runtime_error.
const Cpus& cpus();
/// The calling thread, and those that it starts from now on. False: errno says why not.
bool pin_to(int cpu) noexcept;

}  // namespace agnocast::bench
