// SPDX-License-Identifier: Apache-2.0

#include <client/process/forked_child.hpp>

#include <agnocast/abi/limits.hpp>

#include <pthread.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <iterator>
#include <new>

namespace agnocast {
namespace {

constinit std::atomic<std::uint32_t> always_own{detail::served};

// One for each session of the process; previous sessions end in time.
constexpr std::size_t closed_in_child_max = 64;
// Descriptor number plus one; 0: free.
constinit std::atomic<int> closed_in_child[closed_in_child_max] = {};

// Runs in the child's only thread before any other code: takes no lock, only closes.
void close_in_child() noexcept {
  for (std::atomic<int>& entry : closed_in_child) {
    if (const int fd = entry.exchange(0, std::memory_order_relaxed) - 1; fd >= 0)
      ::close(fd);  // if it is still ours, see base/descriptors/kept_fd.hpp
  }
}

}  // namespace

constinit std::atomic<std::atomic<std::uint32_t>*> detail::own_process_word{&always_own};

Result<void> recognise_forked_children() noexcept {
  if (detail::own_process_word.load(std::memory_order_relaxed) != &always_own) return {};
  // Registering twice is harmless, if a later step fails.
  if (const int refused = ::pthread_atfork(nullptr, nullptr, close_in_child); refused != 0)
    return fail(Errc::os_failure, "registering a handler for forked children", refused);
  void* const page =
      ::mmap(nullptr, abi::page_bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (page == MAP_FAILED) return fail(Errc::os_failure, "making the fork detection page", errno);
  if (::madvise(page, abi::page_bytes, MADV_WIPEONFORK) != 0) {
    const int error = errno;
    ::munmap(page, abi::page_bytes);
    return fail(Errc::os_failure, "making the fork detection page", error);
  }
  detail::own_process_word.store(new (page) std::atomic<std::uint32_t>(detail::served),
                                 std::memory_order_release);
  return {};
}

Result<void> close_in_forked_children(int fd) noexcept {
  for (std::atomic<int>& entry : closed_in_child) {
    int free = 0;
    if (entry.compare_exchange_strong(free, fd + 1, std::memory_order_relaxed)) return {};
  }
  return fail(Errc::limit_reached, "too many previous sessions are still in use");
}

void leave_to_forked_children(int fd) noexcept {
  const auto entry = std::find(std::begin(closed_in_child), std::end(closed_in_child), fd + 1);
  if (entry != std::end(closed_in_child)) entry->store(0, std::memory_order_relaxed);
}

}  // namespace agnocast
