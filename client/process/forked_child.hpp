// SPDX-License-Identifier: Apache-2.0
//
// Forked child: does the library serve this process, or is it a child, made without exec, of one
// that uses it, or was its membership revoked?
//
// Such a child has copies of all our objects and none of our threads; locks may be held for ever;
// sockets, bells and other processes' regions are the parent's; its own region and windows are not
// there (MADV_DONTFORK) or a private copy. So in a child every entry of the library turns round
// before it takes a lock or touches shared memory: creation and publish say shut_down, take finds
// nothing, destructors let go of nothing but memory. The answer comes from a page that the kernel
// wipes at fork, so children of _Fork and clone are known too; it costs two loads.
//
// A descriptor that says something of this process by being open is closed in the child before fork
// returns there (pthread_atfork). Children of _Fork and clone keep it until they call exec or end.
//
// The same page says that the membership was revoked, so nobody on the data path looks twice:
// publish says revoked, take finds nothing; what is held stays, and is let go of as always.
#pragma once

#include <agnocast/result.hpp>

#include <atomic>
#include <cstdint>

namespace agnocast {

/// From now on children of this process are known. Once, before anything that a child could harm.
/// Errors: os_failure.
[[nodiscard]] Result<void> recognise_forked_children() noexcept;

/// Children of fork close this descriptor from now on. After recognise_forked_children(). Any thread.
/// Errors: limit_reached.
[[nodiscard]] Result<void> close_in_forked_children(int fd) noexcept;
/// No longer; to be said before it is closed here. Any thread.
void leave_to_forked_children(int fd) noexcept;

namespace detail {
// Before that: a word that always says `served`.
extern std::atomic<std::atomic<std::uint32_t>*> own_process_word;
inline constexpr std::uint32_t forked = 0;  // as the kernel wipes it
inline constexpr std::uint32_t served = 1;
inline constexpr std::uint32_t revoked = 2;
inline std::uint32_t service_word() noexcept {
  return own_process_word.load(std::memory_order_acquire)->load(std::memory_order_relaxed);
}
}  // namespace detail

/// Any thread.
inline bool is_forked_child() noexcept { return detail::service_word() == detail::forked; }
/// ok, shut_down in a forked child, or revoked. Any thread.
inline Errc service_state() noexcept {
  const std::uint32_t word = detail::service_word();
  if (word == detail::served) return Errc::ok;
  return word == detail::forked ? Errc::shut_down : Errc::revoked;
}
inline bool is_served() noexcept { return detail::service_word() == detail::served; }
/// Sees also what was written before end_service(). Any thread.
inline bool is_revoked() noexcept {
  return detail::own_process_word.load(std::memory_order_acquire)
             ->load(std::memory_order_acquire) == detail::revoked;
}
/// The membership of this process is over, for good. After recognise_forked_children().
inline void end_service() noexcept {
  detail::own_process_word.load(std::memory_order_acquire)
      ->store(detail::revoked, std::memory_order_release);
}

/// What creation functions begin with.
[[nodiscard]] inline Result<void> refuse_forked_child() noexcept {
  if (!is_forked_child()) return {};
  return fail(Errc::shut_down,
              "this process was forked by one that uses agnocast, and has not called exec");
}

}  // namespace agnocast
