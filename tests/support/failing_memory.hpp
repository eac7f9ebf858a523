// SPDX-License-Identifier: Apache-2.0
//
// FailingMemory: what a daemon that is started meanwhile with failing_memory.cpp preloaded looks at:
// which of its loop's allocations fail. They fail as malloc's would: the new-handler is asked, and
// decides whether there is a piece of memory left.
#pragma once

#include <atomic>
#include <cstdint>

namespace agnocast::test {

struct FailingMemory {
  static constexpr const char* variable = "AGNOCAST_TEST_FAILING_MEMORY";
  std::atomic<std::uint64_t> count;          // allocations since first was set
  std::atomic<std::uint64_t> first;          // which one fails, from 1; 0: none
  std::atomic<std::uint64_t> all_that_follow;  // fail as well, but for what the handler gives back
  std::atomic<std::uint64_t> failures;
};

}  // namespace agnocast::test
