// SPDX-License-Identifier: Apache-2.0
//
// Allocates memory behind a mapping without its file's lock.
//
// fallocate(2) waits for the lock of the inode, which any process that may write to the file can
// hold: a write whose source is a page of a FUSE server that does not answer holds it for ever. A
// page fault does not take it, and waits only for a hole that is being punched there. So for a
// file that another process may write, memory is made present through a mapping.
#pragma once

#include <agnocast/result.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast {

/// Makes the pages of [at, at + bytes) present for writing; keeps their content. `at` is the
/// beginning of a page of a writable mapping, and its file, if any, reaches as far. Errors:
/// os_failure (no memory, or the file is shorter), where a store would have raised SIGBUS.
[[nodiscard]] Result<void> populate(std::byte* at, std::uint64_t bytes) noexcept;
/// The same with means of every kernel; populate() uses it before Linux 5.14.
[[nodiscard]] Result<void> populate_page_by_page(std::byte* at, std::uint64_t bytes) noexcept;

}  // namespace agnocast
