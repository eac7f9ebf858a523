// SPDX-License-Identifier: Apache-2.0
//
// The memory that this process can have at all: of the machine, or of the control group that it is in, with all that
// are around that one (cgroup v2, memory.max). Pages of a shared heap are charged to the group of the publisher, which
// touches them first.
#pragma once

#include <cstdint>

namespace agnocast {

/// Bytes. What cannot be read is no bound. A few system calls; keeps nothing open. `root`: where proc and sys are, for
/// tests.
std::uint64_t machine_memory_bytes(const char* root = "") noexcept;

}  // namespace agnocast
