// SPDX-License-Identifier: Apache-2.0
//
// Memfds as this system needs them: one writer, many readers, nobody can resize.
//
// A memfd is made by the daemon with mode 0600 (with the default 0777 a reader could re-open it for
// writing through /proc), sealed against shrinking, growing and further seals, and executable by
// nobody where the kernel can say so. It is not sealed against future writes: that seal also
// forbids punching holes. Readers get a descriptor that was opened O_RDONLY: a read-only mapping of
// a writable descriptor could be made writable again by mprotect.
#pragma once

#include <agnocast/result.hpp>
#include <base/unique_fd.hpp>

#include <cstdint>

namespace agnocast {

/// A sealed memfd of `bytes` (a multiple of the page), sparse, CLOEXEC, readable and writable.
/// `name` shows in /proc/PID/maps. Errors: os_failure with errno (ENOMEM, EMFILE, …). Any thread.
[[nodiscard]] Result<UniqueFd> make_memfd(const char* name, std::uint64_t bytes) noexcept;

/// Another descriptor of the same memory that can only read. Needs /proc. Errors: os_failure with
/// errno. Any thread.
[[nodiscard]] Result<UniqueFd> reopen_read_only(int fd) noexcept;

}  // namespace agnocast
