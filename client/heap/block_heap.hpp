// SPDX-License-Identifier: Apache-2.0
//
// BlockHeap: the shared heap of a process without the heap hook. It has whole blocks, one for each
// message that was copied (api/message_copy.hpp), and malloc knows nothing of it.
//
//     window   |used 192|free 64|used 4096|    free 1 MiB    |used 320|  never used  |
//              0                                                      end          length
//
// An allocation takes the smallest free extent that has room, the lowest of equal ones, or else
// lengthens the used part of the window; then it tries the next window. Freed neighbours join. All
// of its bookkeeping is private memory: readers see the blocks alone. The windows themselves, their
// growth and their return to the system are those of the hook (heaphook/windows.hpp).
//
// Cost: O(log n) for n extents, under one mutex (with an alignment above 64, O(n)); opening pages
// that were returned costs page faults. While purge() returns a free extent nobody can use it: if
// the used part reaches the end of the window, any allocation may find no room meanwhile.
#pragma once

#include <agnocast/abi/heaphook.h>

namespace agnocast {

/// Returns a table that behaves as the hook's in a process in which nothing is interposed: scopes
/// and pauses do nothing, and only `allocate` uses the windows. It is the same for the life of the
/// process. In a forked child `allocate` returns null, a free has no effect, and blocks can be
/// read. Unlike the hook it serves a setuid program.
const agnocast_heaphook_table& block_heap() noexcept;

}  // namespace agnocast
