// SPDX-License-Identifier: Apache-2.0
//
// ipc_shared_ptr: a handle to one message, either a loan (being built by its publisher) or a
// received message. The copies are counted within the process; the last copy of a received
// message releases it to its publisher with one instruction, the last copy of an unpublished loan
// destroys it.
#pragma once

#include <agnocast/export.hpp>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <type_traits>
#include <utility>

namespace agnocast {

/// Metadata of a received message.
struct MessageInfo {
  std::uint64_t sequence = 0;   ///< of its publisher; consecutive, the first is 1
  std::uint64_t publisher = 0;  ///< generation of the publisher: unique during the life of a daemon
  std::uint64_t publish_time_ns = 0;  ///< CLOCK_MONOTONIC when it was published
  std::uint64_t object_bytes = 0;     ///< sizeof the message object
  /// Returns publish_time_ns in CLOCK_REALTIME nanoseconds, by the offset of the two clocks, which
  /// each call reads anew: some microseconds off. Three clock reads, more if the thread is put off.
  AGNOCAST_PUBLIC std::uint64_t source_timestamp() const noexcept;
};

namespace detail {

/// One message that this process uses. Created and destroyed by the library.
struct Block {
  std::atomic<std::uint64_t> users{1};
  std::atomic<void*> message{nullptr};           // null: published or released
  void (*end)(Block* block) noexcept = nullptr;  // called for the last copy; deletes the block
  std::uint64_t lender = 0;                      // LenderId of the lender; 0: received
  Block* next = nullptr;                         // in a chain of taken or of unused blocks
  MessageInfo info;
};

}  // namespace detail

/// Like std::shared_ptr, for T in shared memory. A received message is ipc_shared_ptr<const T>;
/// its memory is read-only. Different threads may use different copies at the same time. After
/// publish() every copy of the loan is empty.
template <class T>
class ipc_shared_ptr {
 public:
  using element_type = T;

  ipc_shared_ptr() noexcept = default;
  ipc_shared_ptr(const ipc_shared_ptr& other) noexcept : ipc_shared_ptr(other.block_) { share(); }
  ipc_shared_ptr(ipc_shared_ptr&& other) noexcept : block_(std::exchange(other.block_, nullptr)) {}
  /// ipc_shared_ptr<T> to ipc_shared_ptr<const T>.
  template <class U, class = std::enable_if_t<std::is_same_v<const U, T> && !std::is_same_v<U, T>>>
  ipc_shared_ptr(const ipc_shared_ptr<U>& other) noexcept : ipc_shared_ptr(other.block_) {
    share();
  }
  template <class U, class = std::enable_if_t<std::is_same_v<const U, T> && !std::is_same_v<U, T>>>
  ipc_shared_ptr(ipc_shared_ptr<U>&& other) noexcept
      : block_(std::exchange(other.block_, nullptr)) {}
  ipc_shared_ptr& operator=(ipc_shared_ptr other) noexcept {
    std::swap(block_, other.block_);
    return *this;
  }
  ~ipc_shared_ptr() { reset(); }

  void reset() noexcept {
    detail::Block* const block = std::exchange(block_, nullptr);
    if (block == nullptr) return;
    // A single user has no rivals, the common case, and needs no locked instruction.
    if (block->users.load(std::memory_order_acquire) == 1 ||
        block->users.fetch_sub(1, std::memory_order_acq_rel) == 1)
      block->end(block);
  }
  /// Null if empty, published or moved from.
  T* get() const noexcept {
    if (block_ == nullptr) return nullptr;
    return static_cast<T*>(block_->message.load(std::memory_order_acquire));
  }
  T& operator*() const noexcept { return *get(); }
  T* operator->() const noexcept { return get(); }
  explicit operator bool() const noexcept { return get() != nullptr; }
  friend bool operator==(const ipc_shared_ptr& a, std::nullptr_t) noexcept { return !a; }
  friend bool operator==(std::nullptr_t, const ipc_shared_ptr& a) noexcept { return !a; }
  friend bool operator!=(const ipc_shared_ptr& a, std::nullptr_t) noexcept { return bool(a); }
  friend bool operator!=(std::nullptr_t, const ipc_shared_ptr& a) noexcept { return bool(a); }
  /// Returns the metadata of a received message; zeros for a loan.
  const MessageInfo& info() const noexcept {
    static const MessageInfo none;
    return block_ != nullptr ? block_->info : none;
  }

  /// For the library: takes over one reference to the block.
  explicit ipc_shared_ptr(detail::Block* block) noexcept : block_(block) {}
  detail::Block* block() const noexcept { return block_; }

 private:
  template <class>
  friend class ipc_shared_ptr;
  void share() noexcept {
    if (block_ != nullptr) block_->users.fetch_add(1, std::memory_order_relaxed);
  }

  detail::Block* block_ = nullptr;
};

/// Returns the message as a std::shared_ptr, for code that takes one: it is held as long as copies
/// live. One allocation. Throws std::bad_alloc.
template <class T>
std::shared_ptr<T> to_shared_ptr(ipc_shared_ptr<T> message) {
  T* const object = message.get();
  return std::shared_ptr<T>(object, [held = std::move(message)](T*) mutable { held.reset(); });
}

}  // namespace agnocast
