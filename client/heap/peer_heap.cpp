// SPDX-License-Identifier: Apache-2.0

#include <base/descriptors/kept_fd.hpp>
#include <client/heap/address_users.hpp>
#include <client/heap/peer_heap.hpp>
#include <client/process/steps.hpp>
#include <region/windows.hpp>

#include <sys/mman.h>
#include <sys/stat.h>

#include <algorithm>
#include <utility>

namespace agnocast {
namespace {

void* at_address(std::uint64_t address) noexcept { return reinterpret_cast<void*>(address); }

// A window's file is as long as its used part, and never gets shorter. Touching memory behind its
// end raises SIGBUS, whatever the owner claims.
std::uint64_t length_of(int fd) noexcept {
  struct stat file {};
  if (::fstat(fd, &file) != 0 || file.st_size < 0) return 0;
  return static_cast<std::uint64_t>(file.st_size) & ~(abi::page_bytes - 1);
}

}  // namespace

PeerHeap::~PeerHeap() {
  for (std::uint64_t i = 0; i < window_count(); ++i) {
    const Window& window = windows_[i];
    if (window.fd) AddressUsers::instance().leave(window.base);
  }
}

Result<void> PeerHeap::append(const Announced& window, UniqueFd fd, DescriptorShare::Part counted,
                              std::uint64_t opened, bool is_blocked, bool lacks_file) noexcept {
  const std::lock_guard lock(growing_);
  const std::uint64_t count = count_.load(std::memory_order_relaxed);
  if (window.number < count) {
    Window& known = windows_[window.number];
    if (!fd || !known.lacks_file.load(std::memory_order_relaxed) || window.base != known.base ||
        !AddressUsers::instance().enter(known.base, known.length, AddressUsers::file_of(fd.get()),
                                        windows_[known.first].base))
      return {};
    known.fd = std::move(fd);
    known.counted = std::move(counted);
    known.lacks_file.store(false, std::memory_order_release);
    return {};  // open() will map it
  }
  if (window.number != count || count >= windows_.size() || window.first > window.number ||
      window.base % abi::page_bytes != 0 || window.length % abi::page_bytes != 0 ||
      window.base + window.length < window.base) {
    return fail(Errc::invalid_argument, "a heap window with impossible numbers");
  }
  const std::uint64_t window_set =
      window.first == window.number ? window.base : windows_[window.first].base;
  if (fd && !AddressUsers::instance().enter(window.base, window.length,
                                            AddressUsers::file_of(fd.get()), window_set)) {
    fd.reset();
    is_blocked = true;
  }
  Window& added = windows_[count];
  if (fd) added.counted = std::move(counted);
  added.fd = std::move(fd);
  added.base = window.base;
  added.length = window.length;
  added.first = window.first;
  added.opened.store(opened, std::memory_order_relaxed);
  added.is_closed.store(is_blocked, std::memory_order_relaxed);
  added.lacks_file.store(lacks_file, std::memory_order_relaxed);
  count_.store(count + 1, std::memory_order_release);
  return {};
}

Result<void> PeerHeap::add(const Announced& window, UniqueFd fd,
                           DescriptorShare::Part counted) noexcept {
  return append(window, std::move(fd), std::move(counted), 0, false);
}

Result<void> PeerHeap::add_without_file(const Announced& window) noexcept {
  return append(window, UniqueFd(), {}, 0, true, true);
}

Result<void> PeerHeap::add_blocked(const Announced& window) noexcept {
  return append(window, UniqueFd(), {}, 0, true);
}

Result<void> PeerHeap::add_own(const Announced& window) noexcept {
  return append(window, UniqueFd(), {}, window.length, false);
}

std::uint64_t PeerHeap::open() noexcept {
  const std::uint64_t count = window_count();
  for (std::uint64_t i = 0; i < count; ++i) {
    Window& window = windows_[i];
    const std::uint64_t claimed =
        region::load_frontier<SharedMemory>(client_region_, i, window.length) &
        ~(abi::page_bytes - 1);
    if (claimed <= window.opened.load(std::memory_order_acquire) ||
        window.lacks_file.load(std::memory_order_acquire) || !window.fd)
      continue;
    const std::lock_guard lock(growing_);
    const std::uint64_t frontier = std::min(claimed, length_of(window.fd.get()));
    const std::uint64_t opened = window.opened.load(std::memory_order_relaxed);
    if (frontier <= opened) continue;
    void* const at = at_address(window.base + opened);
    AGNOCAST_CRASH_POINT(C_peer_open);
    const bool refused = !is_intact(window.fd.get()) ||
                         ::mmap(at, frontier - opened, PROT_READ, MAP_SHARED | MAP_FIXED,
                                window.fd.get(), static_cast<off_t>(opened)) == MAP_FAILED;
    // After a refusal any message of the window set may point beyond the open part.
    window.is_closed.store(refused, std::memory_order_release);
    if (refused) continue;
    ::madvise(at, frontier - opened, MADV_DONTDUMP);
    AGNOCAST_CRASH_POINT(C_peer_opened);
    AddressUsers::instance().mapped(window.base, frontier);
    window.opened.store(frontier, std::memory_order_release);
  }
  return count;
}

WindowSet PeerHeap::window_set_of(std::uint64_t address) const noexcept {
  const std::uint64_t count = window_count();
  std::uint64_t found = 0;
  while (found < count && address - windows_[found].base >= windows_[found].length) ++found;
  WindowSet all;
  if (found == count) return all;
  const std::uint64_t first = windows_[found].first;
  for (std::uint64_t i = first; i < count && windows_[i].first == first; ++i) {
    const std::uint64_t open = windows_[i].opened.load(std::memory_order_acquire);
    static_cast<void>(all.add(windows_[i].base, windows_[i].base + open));
  }
  return all;
}

bool PeerHeap::shows(std::uint64_t window) const noexcept {
  const auto& header = *reinterpret_cast<const abi::ClientRegionHeader*>(client_region_);
  return window < abi::window_count_max &&
         header.window[window].base.load(std::memory_order_acquire) != 0;
}

region::Place PeerHeap::place_of(std::uint64_t address, std::uint64_t size, std::uint64_t count,
                                 Unannounced others, Range* open) const noexcept {
  using region::Place;
  std::uint64_t found = 0;
  while (found < count && address - windows_[found].base >= windows_[found].length) ++found;
  // The message, or memory that it points to, may be in the next window.
  const bool window_set_may_grow =
      found == count || windows_[found].first == windows_[count - 1].first;
  if (window_set_may_grow && others != Unannounced::ignored && shows(count))
    return others == Unannounced::awaited ? Place::awaited : Place::unreachable;
  if (found == count) return Place::outside;
  const Window& window = windows_[found];
  for (std::uint64_t i = window.first; i < count && windows_[i].first == window.first; ++i) {
    if (windows_[i].is_closed.load(std::memory_order_acquire)) return Place::unreachable;
  }
  const Range range{window.base, window.opened.load(std::memory_order_acquire)};
  if (!range.has(address, size)) return Place::outside;
  if (open != nullptr) *open = range;
  return Place::readable;
}

}  // namespace agnocast
