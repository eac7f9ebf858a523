// SPDX-License-Identifier: Apache-2.0
//
// Forked child: tells whether the library serves this process, or the process is a child, made
// without exec, of one that uses the library, or its session was revoked.
//
// Such a child has copies of all our objects and none of our threads; locks may be held for ever;
// sockets, doorbells and other processes' regions belong to the parent; its own region and
// windows are missing (MADV_DONTFORK) or a private copy. So in a child every entry of the library
// returns before it takes a lock or touches shared memory: creation and publish return shut_down,
// take finds nothing, destructors free only private memory. The answer comes from a page that the
// kernel wipes at fork, so children of _Fork and clone are detected too; it costs two loads.
//
// Open descriptors that show that this process lives are closed in the child before fork returns
// there (pthread_atfork). Children of _Fork and clone keep them until they call exec or end.
//
// The same page has the revocation, so the data path checks only one word: publish returns
// revoked, take finds nothing; held messages stay, and can be released as always.
#pragma once

#include <agnocast/result.hpp>

#include <atomic>
#include <cstdint>

namespace agnocast {

/// Makes children of this process detectable. Call it once, before anything that a child could
/// harm. Errors: os_failure.
[[nodiscard]] Result<void> recognise_forked_children() noexcept;

/// Makes children of fork close this descriptor. Call it after recognise_forked_children(). Any
/// thread. Errors: limit_reached.
[[nodiscard]] Result<void> close_in_forked_children(int fd) noexcept;
/// Reverts that; call it before closing the descriptor here. Any thread.
void leave_to_forked_children(int fd) noexcept;

namespace detail {
// Before that: a word that always contains `served`.
extern std::atomic<std::atomic<std::uint32_t>*> own_process_word;
inline constexpr std::uint32_t forked = 0;  // wiped by the kernel
inline constexpr std::uint32_t served = 1;
inline constexpr std::uint32_t revoked = 2;
inline std::uint32_t service_word() noexcept {
  return own_process_word.load(std::memory_order_acquire)->load(std::memory_order_relaxed);
}
}  // namespace detail

/// Returns whether this is a forked child. Any thread.
inline bool is_forked_child() noexcept { return detail::service_word() == detail::forked; }
/// Returns ok, shut_down in a forked child, or revoked. Any thread.
inline Errc service_state() noexcept {
  const std::uint32_t word = detail::service_word();
  if (word == detail::served) return Errc::ok;
  return word == detail::forked ? Errc::shut_down : Errc::revoked;
}
inline bool is_served() noexcept { return detail::service_word() == detail::served; }
/// Returns whether the session was revoked; acquires everything before end_service(). Any thread.
inline bool is_revoked() noexcept {
  return detail::own_process_word.load(std::memory_order_acquire)
             ->load(std::memory_order_acquire) == detail::revoked;
}
/// Ends the session of this process for good. Call it after recognise_forked_children().
inline void end_service() noexcept {
  detail::own_process_word.load(std::memory_order_acquire)
      ->store(detail::revoked, std::memory_order_release);
}

/// Creation functions begin with this.
[[nodiscard]] inline Result<void> refuse_forked_child() noexcept {
  if (!is_forked_child()) return {};
  return fail(Errc::shut_down,
              "this process was forked by one that uses agnocast, and has not called exec");
}

}  // namespace agnocast
