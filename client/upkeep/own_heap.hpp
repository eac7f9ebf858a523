// SPDX-License-Identifier: Apache-2.0
//
// OwnHeap: this process's shared heap as one session has it: its scope, its hook and its windows,
// which the session's daemon gives, or is notified of.
//
//   closed ──open(): the first window──▶ open ──ask_for_window()──▶ one window more … (HeapGrowth)
// a session that begins beside another one continues its heap and brings the windows along:
// continue_from(), bring()
//
// The process has one heap, whatever the number of sessions: its contents stay at their addresses.
#pragma once

#include <agnocast/heap.hpp>
#include <agnocast/residency.hpp>
#include <agnocast/result.hpp>
#include <client/connection/connection.hpp>
#include <client/endpoint/peer_table.hpp>
#include <client/heap/heap.hpp>
#include <client/heap/heap_growth.hpp>

#include <atomic>
#include <cstddef>
#include <mutex>
#include <optional>

namespace agnocast {

class OwnHeap {
 public:
  explicit OwnHeap(PeerTable& peers) noexcept : peers_(peers) {}

  // --- any thread

  /// Sets the scope, before the heap is open. Errors: invalid_argument.
  [[nodiscard]] Result<void> set_scope(HeapScope scope) noexcept;
  /// Opens the heap with its first window, unless it is open. `client_region`: where the frontier
  /// is stored. `grown`: called after that store, without locks of this library; must not allocate.
  /// `by_copy`: a heap of blocks will do. Errors: hook_missing, invalid_argument, the daemon's
  /// refusals, those of Heap::attach.
  [[nodiscard]] Result<void> open(Connection& connection, std::byte* client_region,
                                  void (*grown)() noexcept, bool by_copy);
  bool is_open() const noexcept { return is_open_.load(std::memory_order_acquire); }
  /// Returns null until it is open.
  const Heap* get() const noexcept { return is_open() ? &*heap_ : nullptr; }
  /// Call only after it was opened.
  const Heap& opened() const noexcept { return *heap_; }
  HeapGrowth& growth() noexcept { return growth_; }
  const HeapGrowth& growth() const noexcept { return growth_; }

  // --- while another session begins

  /// Continues the heap of the previous session. It does not grow here before it is permitted to.
  void continue_from(OwnHeap& former);
  /// Reports all windows to the daemon. Errors: limit_reached (too many sessions), the daemon's
  /// refusals.
  [[nodiscard]] Result<void> bring(Connection& connection, std::byte* client_region);

  // --- control thread

  /// Asks for the next window if the heap wants one. `connection` and `client_region` must outlive
  /// the answer.
  void ask_for_window(Connection& connection, std::byte* client_region);

 private:
  bool add_window(Incoming& answer, std::byte* client_region) noexcept;

  PeerTable& peers_;
  std::mutex opening_;
  HeapScope scope_ = HeapScope::loan;
  std::optional<Heap> heap_;
  std::atomic<bool> is_open_{false};
  HeapGrowth growth_;
};

}  // namespace agnocast
