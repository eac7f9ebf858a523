// SPDX-License-Identifier: Apache-2.0

#include <client/forked_child.hpp>

#include <agnocast/abi/limits.hpp>

#include <sys/mman.h>

#include <cerrno>
#include <new>

namespace agnocast {
namespace {

constinit std::atomic<std::uint32_t> always_own{detail::served};

}  // namespace

constinit std::atomic<std::atomic<std::uint32_t>*> detail::own_process_word{&always_own};

Result<void> recognise_forked_children() noexcept {
  if (detail::own_process_word.load(std::memory_order_relaxed) != &always_own) return {};
  void* const page =
      ::mmap(nullptr, abi::page_bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (page == MAP_FAILED) return fail(Errc::os_failure, "a page that knows its process", errno);
  if (::madvise(page, abi::page_bytes, MADV_WIPEONFORK) != 0) {
    const int error = errno;
    ::munmap(page, abi::page_bytes);
    return fail(Errc::os_failure, "a page that knows its process", error);
  }
  detail::own_process_word.store(new (page) std::atomic<std::uint32_t>(detail::served),
                                 std::memory_order_release);
  return {};
}

}  // namespace agnocast
