// SPDX-License-Identifier: Apache-2.0

#include <base/mapping.hpp>
#include <base/step.hpp>
#include <client/dataplane/windows.hpp>
#include <client/peer_heap.hpp>

#include <sys/mman.h>

#include <utility>

namespace agnocast {
namespace {

void* at_address(std::uint64_t address) noexcept { return reinterpret_cast<void*>(address); }

}  // namespace

PeerHeap::~PeerHeap() {
  for (std::uint64_t i = 0; i < window_count(); ++i) {
    const Window& window = windows_[i];
    if (!window.fd || window.opened.load(std::memory_order_relaxed) == 0) continue;
    AGNOCAST_CRASH_POINT(C_peer_cover);
    Mapping::cover(static_cast<std::byte*>(at_address(window.base)),
                   window.opened.load(std::memory_order_relaxed));
  }
}

Result<void> PeerHeap::append(std::uint64_t window, std::uint64_t base, std::uint64_t length,
                              UniqueFd fd, std::uint64_t opened) noexcept {
  const std::lock_guard lock(growing_);
  const std::uint64_t count = count_.load(std::memory_order_relaxed);
  if (window < count) return {};
  if (window != count || window >= windows_.size() || base % abi::page_bytes != 0 ||
      length % abi::page_bytes != 0 || base + length < base) {
    return fail(Errc::invalid_argument, "a heap window that cannot be");
  }
  windows_[window].fd = std::move(fd);
  windows_[window].base = base;
  windows_[window].length = length;
  windows_[window].opened.store(opened, std::memory_order_relaxed);
  count_.store(count + 1, std::memory_order_release);
  return {};
}

Result<void> PeerHeap::add(std::uint64_t window, std::uint64_t base, std::uint64_t length,
                           UniqueFd fd) noexcept {
  return append(window, base, length, std::move(fd), 0);
}

Result<void> PeerHeap::add_own(std::uint64_t window, std::uint64_t base,
                               std::uint64_t length) noexcept {
  return append(window, base, length, UniqueFd(), length);
}

PeerHeap::Reach PeerHeap::open() noexcept {
  // One that is added meanwhile has not been opened.
  const std::uint64_t count = window_count();
  for (std::uint64_t i = 0; i < count; ++i) {
    Window& window = windows_[i];
    const std::uint64_t frontier =
        dataplane::load_frontier<SharedMemory>(client_region_, i, window.length) &
        ~(abi::page_bytes - 1);
    if (frontier <= window.opened.load(std::memory_order_acquire)) continue;
    const std::lock_guard lock(growing_);
    const std::uint64_t opened = window.opened.load(std::memory_order_relaxed);
    if (frontier <= opened) continue;
    void* const at = at_address(window.base + opened);
    AGNOCAST_CRASH_POINT(C_peer_open);
    if (::mmap(at, frontier - opened, PROT_READ, MAP_SHARED | MAP_FIXED, window.fd.get(),
               static_cast<off_t>(opened)) == MAP_FAILED) {
      return Reach::refused;
    }
    ::madvise(at, frontier - opened, MADV_DONTDUMP);
    AGNOCAST_CRASH_POINT(C_peer_opened);
    window.opened.store(frontier, std::memory_order_release);
  }
  const auto& header = *reinterpret_cast<const abi::ClientRegionHeader*>(client_region_);
  const bool shows_more = count < abi::window_count_max &&
                          header.window[count].base.load(std::memory_order_acquire) != 0;
  return shows_more ? Reach::awaits_window : Reach::whole;
}

bool PeerHeap::contains(std::uint64_t address, std::uint64_t size) const noexcept {
  for (std::uint64_t i = 0; i < window_count(); ++i) {
    const Window& window = windows_[i];
    const std::uint64_t opened = window.opened.load(std::memory_order_acquire);
    if (address >= window.base && size <= opened && address - window.base <= opened - size)
      return true;
  }
  return false;
}

}  // namespace agnocast
