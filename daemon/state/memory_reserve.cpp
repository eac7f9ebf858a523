// SPDX-License-Identifier: Apache-2.0

#include <daemon/state/memory_reserve.hpp>

#include <base/check.hpp>
#include <base/memory/populate.hpp>

#include <unistd.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <new>

namespace agnocast::daemon {

thread_local constinit bool MemoryReserve::may_fail_ = false;
thread_local constinit bool MemoryReserve::is_installed_ = false;

namespace {

// The reserve of the thread that has installed it.
constinit std::array<void*, MemoryReserve::piece_count> pieces{};
constinit std::size_t kept = 0;

/// Gives a piece its pages: addresses without memory are no reserve. Saves a page fault for each
/// page but the first and the last, which other blocks share.
bool touch(std::byte* piece) noexcept {
  static const auto page_bytes = static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
  const std::size_t before =
      (page_bytes - reinterpret_cast<std::uintptr_t>(piece) % page_bytes) % page_bytes;
  const std::size_t whole = (MemoryReserve::piece_bytes - before) / page_bytes * page_bytes;
  piece[0] = piece[MemoryReserve::piece_bytes - 1] = std::byte{1};
  return populate(piece + before, whole).has_value();
}

}  // namespace

void MemoryReserve::install() noexcept {
  is_installed_ = true;
  std::set_new_handler(&MemoryReserve::on_failure);
  static_cast<void>(refill());
}

bool MemoryReserve::refill() noexcept {
  if (!is_installed_) return true;
  while (kept < piece_count) {
    void* const piece = std::malloc(piece_bytes);
    if (piece == nullptr) return false;
    if (!touch(static_cast<std::byte*>(piece))) {
      std::free(piece);
      return false;
    }
    pieces[kept++] = piece;
  }
  return true;
}

// operator new tries again when this returns.
void MemoryReserve::on_failure() {
  if (!is_installed_ || may_fail_) throw std::bad_alloc();
  AGNOCAST_CHECK(kept > 0);
  std::free(pieces[--kept]);
}

}  // namespace agnocast::daemon
