// SPDX-License-Identifier: Apache-2.0
//
// Memfds of this system: one writer, many readers, never shortened.
//
// The daemon makes a memfd with mode 0600 (with the default 0777 a reader could re-open it for
// writing through /proc), sealed against shrinking and further seals, and not executable where
// the kernel supports that. It is not sealed against future writes: that seal also forbids
// punching holes. Readers get a descriptor opened O_RDONLY: mprotect could make a read-only
// mapping of a writable descriptor writable again.
//
// A reader that touches a hole through its mapping allocates a page, up to the end of the file.
// So a file that fills gradually is only as long as its used part, and grows with it: may_grow.
// The length of the others is sealed.
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>

#include <cstdint>

namespace agnocast {

/// Makes a sealed memfd of `bytes` (a multiple of the page), sparse, CLOEXEC, readable and
/// writable. /proc/PID/maps shows `name`. Errors: os_failure with errno (ENOMEM, EMFILE, …). Any
/// thread.
enum class Length : std::uint8_t { fixed, may_grow };
[[nodiscard]] Result<UniqueFd> make_memfd(const char* name, std::uint64_t bytes,
                                          Length length = Length::fixed) noexcept;
/// Lengthens a file that may grow to at least `bytes`. Never shortens one. Errors: os_failure
/// with errno. Any thread.
[[nodiscard]] Result<void> lengthen(int fd, std::uint64_t bytes) noexcept;

/// Forbids punching holes into this memory, also for root: makes the file immutable (chattr(1),
/// +i). Owners of a writable descriptor can still map, write and lengthen it, but it cannot be
/// opened again for writing. Call it before another process has a descriptor: it waits for the
/// lock of the file. Needs Linux 6.0 and CAP_LINUX_IMMUTABLE in the first user namespace. Errors:
/// os_failure with errno (ENOTTY, EPERM).
[[nodiscard]] Result<void> forbid_holes(int fd) noexcept;

/// Opens a read-only descriptor of the same memory. Needs /proc. Errors: os_failure with errno.
/// Any thread.
[[nodiscard]] Result<UniqueFd> reopen_read_only(int fd) noexcept;

/// Locks all of the memory for writing, for the open file description behind `writer` (an OFD
/// lock), however many descriptors share it. A second call on the same description changes
/// nothing. A read-only descriptor cannot take this lock, but another one that prevents it: lock
/// before another process has one. Errors: os_failure with errno (EAGAIN: a part is locked by
/// another description).
[[nodiscard]] Result<void> lock_for_writing(int writer) noexcept;

}  // namespace agnocast
