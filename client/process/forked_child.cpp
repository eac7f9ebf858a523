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

// One for each membership of the process, and former ones end.
constexpr std::size_t closed_in_child_max = 64;
// A descriptor and one; 0: free.
constinit std::atomic<int> closed_in_child[closed_in_child_max] = {};

// The child's only thread, before it runs anything else: no lock, nothing but close.
void close_in_child() noexcept {
  for (std::atomic<int>& entry : closed_in_child) {
    if (const int fd = entry.exchange(0, std::memory_order_relaxed) - 1; fd >= 0)
      ::close(fd);  // if it is ours, see base/kept_fd.hpp
  }
}

}  // namespace

constinit std::atomic<std::atomic<std::uint32_t>*> detail::own_process_word{&always_own};

Result<void> recognise_forked_children() noexcept {
  if (detail::own_process_word.load(std::memory_order_relaxed) != &always_own) return {};
  // Twice does no harm, should what follows be refused.
  if (const int refused = ::pthread_atfork(nullptr, nullptr, close_in_child); refused != 0)
    return fail(Errc::os_failure, "a handler for forked children", refused);
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

Result<void> close_in_forked_children(int fd) noexcept {
  for (std::atomic<int>& entry : closed_in_child) {
    int free = 0;
    if (entry.compare_exchange_strong(free, fd + 1, std::memory_order_relaxed)) return {};
  }
  return fail(Errc::limit_reached, "too many former memberships are still in use");
}

void leave_to_forked_children(int fd) noexcept {
  const auto entry = std::find(std::begin(closed_in_child), std::end(closed_in_child), fd + 1);
  if (entry != std::end(closed_in_child)) entry->store(0, std::memory_order_relaxed);
}

}  // namespace agnocast
