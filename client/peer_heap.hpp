// SPDX-License-Identifier: Apache-2.0
//
// PeerHeap: somebody else's heap windows, read-only, at the addresses where their owner has them.
//
// The addresses are reserved without access by the caller (the arena, reserved at hello); only what
// the owner's frontier says is in use gets mapped. A process that has locked its memory (mlockall)
// would otherwise allocate the whole window. Left out of core dumps, never populated: touching a
// hole through a read-only mapping allocates a page.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/result.hpp>
#include <base/unique_fd.hpp>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <mutex>

namespace agnocast {

/// Any thread may call anything. open() and contains() take a lock only after the owner's heap has
/// grown.
class PeerHeap {
 public:
  /// `client_region`: the owner's, mapped here; must outlive this.
  explicit PeerHeap(std::byte* client_region) noexcept : client_region_(client_region) {}
  /// Puts the reservation back in place of what was mapped. Nobody may use a message of this heap
  /// any more.
  ~PeerHeap();
  PeerHeap(const PeerHeap&) = delete;
  PeerHeap& operator=(const PeerHeap&) = delete;

  /// Window number `window` as the daemon announced it; `fd` opened for reading, [base, base +
  /// length) reserved by the caller. Windows come in order; one that is there already is ignored.
  /// Errors: invalid_argument.
  [[nodiscard]] Result<void> add(std::uint64_t window, std::uint64_t base, std::uint64_t length,
                                 UniqueFd fd) noexcept;
  /// The same for this process's own heap, which the hook has mapped already.
  [[nodiscard]] Result<void> add_own(std::uint64_t window, std::uint64_t base,
                                     std::uint64_t length) noexcept;

  enum class Reach : std::uint8_t {
    whole,          ///< every window that the owner's header shows, up to its frontier
    awaits_window,  ///< the header shows one more that has not been added yet
    refused,        ///< the system refuses a mapping
  };
  /// Makes accessible what the owner has put to use since the last call. A system call only after
  /// growth. Whatever was committed before may have pointers into all of it, wherever its object
  /// lies.
  [[nodiscard]] Reach open() noexcept;
  /// True when [address, address + size) lies in what is open. Any values.
  bool contains(std::uint64_t address, std::uint64_t size) const noexcept;
  std::uint64_t window_count() const noexcept { return count_.load(std::memory_order_acquire); }

 private:
  struct Window {
    UniqueFd fd;
    std::uint64_t base = 0;
    std::uint64_t length = 0;
    std::atomic<std::uint64_t> opened{0};  // bytes; only grows
  };
  Result<void> append(std::uint64_t window, std::uint64_t base, std::uint64_t length, UniqueFd fd,
                      std::uint64_t opened) noexcept;

  std::byte* client_region_;
  std::mutex growing_;
  std::array<Window, abi::window_count_max> windows_;
  std::atomic<std::uint64_t> count_{0};
};

/// One take's look at a heap (the Windows of dataplane::LinkCore). A message is handed out only when
/// everything that it may point to is open; until then it stays unread. A header that lies about
/// windows delays only the liar's own messages, and those not after its end: `all_announced` says
/// that every window these messages can lie in has been added.
class HeapLook {
 public:
  HeapLook(PeerHeap& heap, bool all_announced) noexcept
      : heap_(heap), all_announced_(all_announced) {}
  void open() noexcept {
    reach_ = heap_.open();
    if (all_announced_ && reach_ == PeerHeap::Reach::awaits_window) reach_ = PeerHeap::Reach::whole;
  }
  bool contains(std::uint64_t address, std::uint64_t size) const noexcept {
    return reach_ == PeerHeap::Reach::whole && heap_.contains(address, size);
  }
  bool is_awaited(std::uint64_t, std::uint64_t) const noexcept {
    return reach_ == PeerHeap::Reach::awaits_window;
  }

 private:
  PeerHeap& heap_;
  const bool all_announced_;
  PeerHeap::Reach reach_ = PeerHeap::Reach::refused;
};

}  // namespace agnocast
