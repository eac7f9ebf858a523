// SPDX-License-Identifier: Apache-2.0

#include <daemon/state/memory_reserve.hpp>

#include <base/check.hpp>
#include <base/memory/populate.hpp>

#include <unistd.h>

#include <array>
#include <cstddef>
#include <cstdlib>
#include <new>

namespace agnocast::daemon {

thread_local constinit bool MemoryReserve::may_fail_ = false;
thread_local constinit bool MemoryReserve::is_installed_ = false;

namespace {

// The reserve of the thread that has installed it.
constinit std::array<void*, MemoryReserve::piece_count> pieces{};
constinit std::size_t kept = 0;

}  // namespace

void MemoryReserve::install() noexcept {
  is_installed_ = true;
  std::set_new_handler(&MemoryReserve::on_failure);
  static_cast<void>(refill());
}

bool MemoryReserve::refill() noexcept {
  if (!is_installed_) return true;
  while (kept < piece_count) {
    static const auto page_bytes = static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
    void* const piece = std::aligned_alloc(page_bytes, piece_bytes);
    if (piece == nullptr) return false;
    // Addresses without memory are no reserve.
    if (!populate(static_cast<std::byte*>(piece), piece_bytes)) {
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
