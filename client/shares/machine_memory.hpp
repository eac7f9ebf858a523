// SPDX-License-Identifier: Apache-2.0
//
// The memory available to this process: that of the machine, or the limit of its control group
// and all groups around it (cgroup v2, memory.max). Pages of a shared heap are charged to the
// group of the publisher, which touches them first.
#pragma once

#include <cstdint>

namespace agnocast {

/// Returns bytes. Unreadable limits are no bound. A few system calls; keeps nothing open. `root`:
/// path before /proc and /sys, for tests.
std::uint64_t machine_memory_bytes(const char* root = "") noexcept;

}  // namespace agnocast
