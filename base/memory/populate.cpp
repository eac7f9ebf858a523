// SPDX-License-Identifier: Apache-2.0

#include <base/memory/populate.hpp>

#include <linux/futex.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>

#ifndef MADV_POPULATE_WRITE
#define MADV_POPULATE_WRITE 23  // Linux 5.14, not in glibc 2.34
#endif

namespace agnocast {
namespace {

constexpr const char* what = "backing shared memory with pages";

}  // namespace

Result<void> populate(std::byte* at, std::uint64_t bytes) noexcept {
  for (;;) {
    if (::madvise(at, bytes, MADV_POPULATE_WRITE) == 0) return {};
    if (errno == EINVAL) return populate_page_by_page(at, bytes);
    if (errno != EINTR && errno != EAGAIN) return fail(Errc::os_failure, what, errno);
  }
}

// FUTEX_WAKE_OP changes a word of user memory in the kernel, here by `| 0`, and returns EFAULT
// where a store of the process itself would raise SIGBUS: futex(2).
Result<void> populate_page_by_page(std::byte* at, std::uint64_t bytes) noexcept {
  static const auto page_bytes = static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
  std::uint32_t nobody_waits = 0;
  for (std::uint64_t offset = 0; offset < bytes; offset += page_bytes) {
    if (::syscall(SYS_futex, &nobody_waits, FUTEX_WAKE_OP | FUTEX_PRIVATE_FLAG, 0, nullptr,
                  at + offset, FUTEX_OP(FUTEX_OP_OR, 0, FUTEX_OP_CMP_EQ, 0)) < 0)
      return fail(Errc::os_failure, what, errno);
  }
  return {};
}

}  // namespace agnocast
