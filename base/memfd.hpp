// SPDX-License-Identifier: Apache-2.0
//
// Memfds as this system needs them: one writer, many readers, nobody can make them shorter.
//
// A memfd is made by the daemon with mode 0600 (with the default 0777 a reader could re-open it for
// writing through /proc), sealed against shrinking and further seals, and executable by nobody
// where the kernel can say so. It is not sealed against future writes: that seal also forbids
// punching holes. Readers get a descriptor that was opened O_RDONLY: a read-only mapping of a
// writable descriptor could be made writable again by mprotect.
//
// A reader that touches a hole through its mapping makes a page, up to the end of the file. So what
// is used bit by bit is as long as what is used of it, and grows with that: may_grow. Of the others
// nobody changes the length.
#pragma once

#include <agnocast/result.hpp>
#include <base/unique_fd.hpp>

#include <cstdint>

namespace agnocast {

/// A sealed memfd of `bytes` (a multiple of the page), sparse, CLOEXEC, readable and writable.
/// `name` shows in /proc/PID/maps. Errors: os_failure with errno (ENOMEM, EMFILE, …). Any thread.
enum class Length : std::uint8_t { fixed, may_grow };
[[nodiscard]] Result<UniqueFd> make_memfd(const char* name, std::uint64_t bytes,
                                          Length length = Length::fixed) noexcept;
/// Of a file that may grow: at least `bytes` from now on. A file is never made shorter. Errors:
/// os_failure with errno. Any thread.
[[nodiscard]] Result<void> lengthen(int fd, std::uint64_t bytes) noexcept;

/// Nobody can punch holes into this memory any more, root included: the file becomes immutable (chattr(1), +i). It
/// can still be mapped, written and lengthened by who has a writable descriptor, but no further one can be opened.
/// Call it before anybody else has a descriptor: it waits for the lock of the file. Needs Linux 6.0 and
/// CAP_LINUX_IMMUTABLE in the first user namespace. Errors: os_failure with errno (ENOTTY, EPERM).
[[nodiscard]] Result<void> forbid_holes(int fd) noexcept;

/// Another descriptor of the same memory that can only read. Needs /proc. Errors: os_failure with
/// errno. Any thread.
[[nodiscard]] Result<UniqueFd> reopen_read_only(int fd) noexcept;

/// Locks all of the memory for writing, as the open file description behind `writer` (an OFD lock),
/// however many descriptors share it. A second call on the same description changes nothing. A
/// descriptor that can only read takes no such lock, but one that prevents it: lock before
/// anybody has one. Errors: os_failure with errno (EAGAIN: somebody else has locked a part of it).
[[nodiscard]] Result<void> lock_for_writing(int writer) noexcept;

}  // namespace agnocast
