// SPDX-License-Identifier: Apache-2.0
//
// PeerHeap: another process's heap windows, read-only, at the addresses where their owner has
// them.
//
// The caller has reserved the addresses without access (the arena, reserved at hello), or they
// are blocked: another mapping of this process is there, and the window is known but never
// mapped. Of the others, only the part up to the owner's frontier is mapped: a process that has
// locked its memory (mlockall) would otherwise allocate the whole window. Excluded from core
// dumps, never populated: touching a hole through a read-only mapping allocates a page.
#pragma once

#include <agnocast/abi/limits.hpp>
#include <agnocast/residency.hpp>
#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <client/shares/descriptor_share.hpp>
#include <region/windows.hpp>

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <mutex>

namespace agnocast {

/// How to treat a window that the owner's header shows but that was not announced.
enum class Unannounced : std::uint8_t {
  awaited,  // its announcement is on its way: messages that may lie or point there stay unread
  ignored,  // everything that these messages need was announced, so the header lies
  lost,     // no announcement will come: messages that may lie or point there cannot be read
};

/// Any thread may call any function. open() takes a lock only after the owner's heap has grown.
class PeerHeap {
 public:
  /// `client_region`: the owner's, mapped here; must outlive this object.
  explicit PeerHeap(std::byte* client_region) noexcept : client_region_(client_region) {}
  /// Replaces the mappings by the reservation, unless another session of this process has them as
  /// well. No message of this heap may be in use any more.
  ~PeerHeap();
  PeerHeap(const PeerHeap&) = delete;
  PeerHeap& operator=(const PeerHeap&) = delete;

  /// A window as announced by the daemon.
  struct Announced {
    std::uint64_t number;
    std::uint64_t base;
    std::uint64_t length;
    std::uint64_t first;  // of its window set
  };
  /// Adds a window; `fd` is opened for reading, the caller has reserved the addresses. Windows
  /// come in order; a known one is ignored, and one whose addresses are in use counts as blocked.
  /// Errors: invalid_argument.
  [[nodiscard]] Result<void> add(const Announced& window, UniqueFd fd,
                                 DescriptorShare::Part counted = {}) noexcept;
  /// The same for an owner whose user has no share of descriptors left: nothing in the window can
  /// be read until it is added again with a file.
  [[nodiscard]] Result<void> add_without_file(const Announced& window) noexcept;
  /// Returns whether the window is here, with its file if it needs one.
  bool has(std::uint64_t number) const noexcept {
    return number < window_count() && !windows_[number].lacks_file.load(std::memory_order_acquire);
  }
  /// The same where another mapping of this process is.
  [[nodiscard]] Result<void> add_blocked(const Announced& window) noexcept;
  /// The same for this process's own heap, which the hook has mapped already.
  [[nodiscard]] Result<void> add_own(const Announced& window) noexcept;

  /// Maps the bytes the owner took into use since the last call. Returns the number of windows
  /// checked: one added meanwhile has not been opened. A system call only after growth.
  std::uint64_t open() noexcept;
  struct Range {
    std::uint64_t base = 0;
    std::uint64_t bytes = 0;
    bool has(std::uint64_t address, std::uint64_t size) const noexcept {
      return size <= bytes && address - base <= bytes - size;
    }
  };
  /// Returns whether a message at [address, address + size) can be read, with everything it
  /// points to, after `count` windows were opened. Any values. `open`: receives the open part of
  /// its window, if readable.
  region::Place place_of(std::uint64_t address, std::uint64_t size, std::uint64_t count,
                         Unannounced others, Range* open = nullptr) const noexcept;
  /// Returns the memory that may contain the message at `address` with everything it owns: the
  /// open parts of its window set. Empty if the address is in no window.
  WindowSet window_set_of(std::uint64_t address) const noexcept;
  /// Returns the base of the first window; 0: there is none.
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
    std::atomic<bool> is_closed{false};    // blocked, or the system refuses to map the used part
    std::atomic<bool> lacks_file{false};   // stored with release behind `fd`
  };
  Result<void> append(const Announced& window, UniqueFd fd, DescriptorShare::Part counted,
                      std::uint64_t opened, bool is_blocked, bool lacks_file = false) noexcept;
  bool shows(std::uint64_t window) const noexcept;

  std::byte* client_region_;
  std::mutex growing_;
  std::array<Window, abi::window_count_max> windows_;
  std::atomic<std::uint64_t> count_{0};
};

/// A take's view of a heap (the Windows of dataplane::LinkCore). It returns a message only if
/// everything that the message may point to is open; until then the message stays unread. A
/// header that lies about windows delays only the liar's own messages, and not those after its
/// end.
///
/// Messages committed up to one head lie in windows shown and used by then, so takes after the
/// same look at the head need one open() here, and one check of each window.
class HeapLook {
 public:
  /// `head`: the head that the takes use. Without one it is for a single take.
  HeapLook(PeerHeap& heap, Unannounced others, const std::uint64_t& head = no_head) noexcept
      : heap_(heap), others_(others), head_(head) {}
  /// For the following takes.
  void expect(Unannounced others) noexcept { others_ = others; }
  void open() noexcept {
    // The next message may wait for a window that was announced meanwhile.
    if (head_ == opened_for_ && heap_.window_count() == count_) return;
    readable_ = {};
    count_ = heap_.open();
    opened_for_ = head_;
  }
  region::Place place_of(std::uint64_t address, std::uint64_t size) noexcept {
    if (readable_.has(address, size)) return region::Place::readable;
    const region::Place place = heap_.place_of(address, size, count_, others_, &readable_);
    // Otherwise the next take must open again: the missing part may be there by then.
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
