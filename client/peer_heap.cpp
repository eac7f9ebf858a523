// SPDX-License-Identifier: Apache-2.0

#include <client/dataplane/windows.hpp>
#include <client/peer_heap.hpp>

#include <sys/mman.h>

#include <cerrno>

namespace agnocast {

Result<void> PeerHeap::add(std::uint64_t base, std::uint64_t length, UniqueFd fd) noexcept {
  if (count_ == windows_.size())
    return fail(Errc::invalid_argument, "more heap windows than a process may have");
  Result<Mapping> reservation = Mapping::reserve(base, length);
  if (!reservation) return tl::unexpected<Failure>(reservation.error());
  Window& window = windows_[count_++];
  window.reservation = std::move(*reservation);
  window.fd = std::move(fd);
  window.base = base;
  window.length = length;
  return {};
}

void PeerHeap::open() noexcept {
  for (std::uint64_t i = 0; i < count_; ++i) {
    Window& window = windows_[i];
    std::uint64_t frontier =
        dataplane::load_frontier<SharedMemory>(client_region_, i, window.length);
    frontier &= ~(abi::page_bytes - 1);
    if (frontier <= window.opened) continue;
    std::byte* const at = window.reservation.base() + window.opened;
    const std::uint64_t bytes = frontier - window.opened;
    void* const mapped = ::mmap(at, bytes, PROT_READ, MAP_SHARED | MAP_FIXED, window.fd.get(),
                                static_cast<off_t>(window.opened));
    if (mapped == MAP_FAILED)
      return;  // what lies beyond stays closed: contains() refuses it, and the message counts as
               // malformed
    ::madvise(at, bytes, MADV_DONTDUMP);
    window.opened = frontier;
  }
}

bool PeerHeap::contains(std::uint64_t address, std::uint64_t size) const noexcept {
  for (std::uint64_t i = 0; i < count_; ++i) {
    const Window& window = windows_[i];
    if (address >= window.base && size <= window.opened &&
        address - window.base <= window.opened - size)
      return true;
  }
  return false;
}

}  // namespace agnocast
