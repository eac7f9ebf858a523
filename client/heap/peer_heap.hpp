// SPDX-License-Identifier: Apache-2.0
//
// PeerHeap: somebody else's heap windows, read-only, at the addresses where their owner has them.
//
// The addresses are reserved without access by the caller (the arena, reserved at hello), or they are
// blocked: something else of this process lies there, and the window is known but never mapped. Of the
// others, only what the owner's frontier says is in use gets mapped. A process that has locked its memory (mlockall)
// would otherwise allocate the whole window. Left out of core dumps, never populated: touching a
// hole through a read-only mapping allocates a page.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/residency.hpp>
#include <agnocast/result.hpp>
#include <base/unique_fd.hpp>
#include <client/shares/descriptor_share.hpp>
#include <region/windows.hpp>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <mutex>

namespace agnocast {

/// A window that the owner's header shows and that was not announced.
enum class Unannounced : std::uint8_t {
  awaited,  // its announcement is on its way: what may lie there, or point there, is left unread
  ignored,  // everything that these messages can lie in was announced, so the header lies
  lost,     // nobody announces any more: what may lie there, or point there, cannot be read
};

/// Any thread may call anything. open() takes a lock only after the owner's heap has grown.
class PeerHeap {
 public:
  /// `client_region`: the owner's, mapped here; must outlive this.
  explicit PeerHeap(std::byte* client_region) noexcept : client_region_(client_region) {}
  /// Puts the reservation back in place of what was mapped, unless another membership of this process
  /// has it as well. Nobody may use a message of this heap any more.
  ~PeerHeap();
  PeerHeap(const PeerHeap&) = delete;
  PeerHeap& operator=(const PeerHeap&) = delete;

  /// A window as the daemon announced it.
  struct Announced {
    std::uint64_t number;
    std::uint64_t base;
    std::uint64_t length;
    std::uint64_t first;  // of its group
  };
  /// `fd` opened for reading, the addresses reserved by the caller. Windows come in order; one that is
  /// there already is ignored, and one whose addresses are in use for something else is as blocked.
  /// Errors: invalid_argument.
  [[nodiscard]] Result<void> add(const Announced& window, UniqueFd fd,
                                 DescriptorShare::Part counted = {}) noexcept;
  /// The same of an owner whose user has no share of descriptors left: nothing in it can be read until it is
  /// added once more with a file.
  [[nodiscard]] Result<void> add_without_file(const Announced& window) noexcept;
  /// Is it here, with its file if it needs one?
  bool has(std::uint64_t number) const noexcept {
    return number < window_count() &&
           !windows_[number].lacks_file.load(std::memory_order_acquire);
  }
  /// The same where this process has something else.
  [[nodiscard]] Result<void> add_blocked(const Announced& window) noexcept;
  /// The same for this process's own heap, which the hook has mapped already.
  [[nodiscard]] Result<void> add_own(const Announced& window) noexcept;

  /// Makes accessible what the owner has put to use since the last call; how many windows it has
  /// looked at: one that is added meanwhile has not been opened. A system call only after growth.
  std::uint64_t open() noexcept;
  struct Range {
    std::uint64_t base = 0;
    std::uint64_t bytes = 0;
    bool has(std::uint64_t address, std::uint64_t size) const noexcept {
      return size <= bytes && address - base <= bytes - size;
    }
  };
  /// Whether a message at [address, address + size) can be read, with all it points to, when `count`
  /// windows have been opened. Any values. `open`: what of its window is, if it can.
  region::Place place_of(std::uint64_t address, std::uint64_t size, std::uint64_t count,
                            Unannounced others, Range* open = nullptr) const noexcept;
  /// Where the message at `address` may lie with all it owns: what is open of the windows of its group.
  /// Empty: in none of them.
  WindowSet group_of(std::uint64_t address) const noexcept;
  /// Of the first window; 0: it has none.
  std::uint64_t first_address() const noexcept {
    return window_count() != 0 ? windows_[0].base : 0;
  }
  std::uint64_t window_count() const noexcept { return count_.load(std::memory_order_acquire); }

 private:
  struct Window {
    UniqueFd fd;
    DescriptorShare::Part counted;
    std::uint64_t base = 0;
    std::uint64_t length = 0;
    std::uint64_t first = 0;
    std::atomic<std::uint64_t> opened{0};  // bytes; only grows
    std::atomic<bool> is_closed{false};    // blocked, or the system refuses to map what is in use
    std::atomic<bool> lacks_file{false};   // release behind `fd`
  };
  Result<void> append(const Announced& window, UniqueFd fd, DescriptorShare::Part counted,
                      std::uint64_t opened, bool is_blocked, bool lacks_file = false) noexcept;
  bool shows(std::uint64_t window) const noexcept;

  std::byte* client_region_;
  std::mutex growing_;
  std::array<Window, abi::window_count_max> windows_;
  std::atomic<std::uint64_t> count_{0};
};

/// A take's look at a heap (the Windows of dataplane::LinkCore). A message is handed out only when
/// everything that it may point to is open; until then it stays unread. A header that lies about
/// windows delays only the liar's own messages, and those not after its end.
///
/// What was committed up to one head lies in what was shown and in use by then, so takes behind the
/// same look at the head need one look here, and ask about each window once.
class HeapLook {
 public:
  /// `head`: where the takes have theirs. Without one it is for a single take.
  HeapLook(PeerHeap& heap, Unannounced others, const std::uint64_t& head = no_head) noexcept
      : heap_(heap), others_(others), head_(head) {}
  /// For the takes that follow.
  void expect(Unannounced others) noexcept { others_ = others; }
  void open() noexcept {
    // A window that was announced meanwhile may be what the next message waits for.
    if (head_ == opened_for_ && heap_.window_count() == count_) return;
    readable_ = {};
    count_ = heap_.open();
    opened_for_ = head_;
  }
  region::Place place_of(std::uint64_t address, std::uint64_t size) noexcept {
    if (readable_.has(address, size)) return region::Place::readable;
    const region::Place place = heap_.place_of(address, size, count_, others_, &readable_);
    // Otherwise the next take has to look: what is missing may be there by then.
    if (place != region::Place::readable) opened_for_ = nothing;
    return place;
  }

 private:
  static constexpr std::uint64_t no_head = 0, nothing = ~std::uint64_t{0};
  PeerHeap& heap_;
  Unannounced others_;
  const std::uint64_t& head_;
  std::uint64_t opened_for_ = nothing;
  std::uint64_t count_ = 0;
  PeerHeap::Range readable_;
};

}  // namespace agnocast
