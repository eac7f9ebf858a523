// SPDX-License-Identifier: Apache-2.0
//
// FailingMemory: controls a daemon that is started with failing_memory.cpp preloaded: which
// allocations of its loop fail. They fail like malloc: the new-handler decides whether there is a
// piece of memory left.
#pragma once

#include <atomic>
#include <cstdint>

namespace agnocast::test {

struct FailingMemory {
  static constexpr const char* variable = "AGNOCAST_TEST_FAILING_MEMORY";
  std::atomic<std::uint64_t> count;            // allocations since first was set
  std::atomic<std::uint64_t> first;            // the one that fails, from 1; 0: none
  std::atomic<std::uint64_t> all_that_follow;  // fail too, beyond what the handler gives back
  std::atomic<std::uint64_t> failures;
};

}  // namespace agnocast::test
