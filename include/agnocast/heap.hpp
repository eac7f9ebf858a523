// SPDX-License-Identifier: Apache-2.0
//
// What a program decides about its shared heap. Everything here is optional: a loan by itself has
// its memory where it must be.
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/result.hpp>

#include <cstdint>

namespace agnocast {

/// Which allocations of a process lie in its shared heap once it has a publisher.
enum class HeapScope : std::uint8_t {
  loan,  ///< Those of a thread while it has a loan open. The default.
  all,   ///< All: a message made anywhere is published without a copy. Such a process must not fork
  ///< without exec, and everything it allocates counts against its heap quota and is readable
  ///< by its subscribers.
};

/// Chooses the scope. The heap is opened with the first publisher, so call this before; what was
/// allocated earlier stays private. AGNOCAST_SCOPE=loan|all in the environment wins: it is the word
/// of whoever starts the process. Errors: invalid_argument: the heap is open with the other scope.
/// Any thread.
[[nodiscard]] AGNOCAST_PUBLIC Result<void> set_heap_scope(HeapScope scope) noexcept;

}  // namespace agnocast
