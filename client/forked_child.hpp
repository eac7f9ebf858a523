// SPDX-License-Identifier: Apache-2.0
//
// Forked child: is this process a child, made without exec, of one that uses the library?
//
// Such a child has copies of all our objects and none of our threads; locks may be held for ever;
// sockets, bells and other processes' regions are the parent's; its own region and windows are not
// there (MADV_DONTFORK) or a private copy. So in a child every entry of the library turns round
// before it takes a lock or touches shared memory: creation and publish say shut_down, take finds
// nothing, destructors let go of nothing but memory. The answer comes from a page that the kernel
// wipes at fork, so children of _Fork and clone are known too; it costs two loads.
#pragma once

#include <agnocast/result.hpp>

#include <atomic>
#include <cstdint>

namespace agnocast {

/// From now on children of this process are known. Once, before anything that a child could harm.
/// Errors: os_failure.
[[nodiscard]] Result<void> recognise_forked_children() noexcept;

namespace detail {
// 1 in the process that uses the library, 0 in its children. Before that: a constant 1.
extern std::atomic<const std::atomic<std::uint32_t>*> own_process_word;
}  // namespace detail

/// Any thread.
inline bool is_forked_child() noexcept {
  return detail::own_process_word.load(std::memory_order_acquire)
             ->load(std::memory_order_relaxed) == 0;
}

/// What creation functions begin with.
[[nodiscard]] inline Result<void> refuse_forked_child() noexcept {
  if (!is_forked_child()) return {};
  return fail(Errc::shut_down,
              "this process was forked by one that uses agnocast, and has not called exec");
}

}  // namespace agnocast
