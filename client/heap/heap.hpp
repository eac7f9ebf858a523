// SPDX-License-Identifier: Apache-2.0
//
// Heap: this process's shared heap, through the heap hook, which is found by name at run time. A
// process without the hook has a heap of blocks (block_heap.hpp), into which messages are copied.
#pragma once

#include <agnocast/abi/heaphook.h>
#include <agnocast/heap.hpp>
#include <agnocast/residency.hpp>
#include <agnocast/result.hpp>
#include <base/descriptors/unique_fd.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast {

class Heap {
 public:
  /// Looks for the hook; without one it is a heap of blocks. Errors: hook_missing (a hook of
  /// another version).
  [[nodiscard]] static Result<Heap> find();
  /// Returns why this process has no hook: hook_missing.
  [[nodiscard]] static tl::unexpected<Failure> missing_hook();

  /// Opens the first window. `client_region`: where the frontier is stored; `grown`: called after
  /// the store, outside the library's locks; it must not allocate. Errors: hook_missing,
  /// arena_occupied, lock_limit, os_failure.
  [[nodiscard]] Result<void> attach(std::byte* client_region, std::uint64_t base,
                                    std::uint64_t length, UniqueFd write_fd, int read_fd,
                                    HeapScope scope, void (*grown)() noexcept);
  /// Returns whether this is a heap of blocks: nothing is allocated there but copies of messages.
  bool copies() const noexcept;
  /// Checks that ordinary allocations in a scope come from this heap, which attach has found out.
  /// Errors: hook_ineffective (another library provides malloc or new).
  [[nodiscard]] Result<void> check_interposition() const;
  /// Adds the next window; a `fresh` one is the only one to allocate from, and to publish from,
  /// until others are added.
  [[nodiscard]] Result<void> add_window(std::byte* client_region, std::uint64_t window,
                                        std::uint64_t base, std::uint64_t length, UniqueFd write_fd,
                                        int read_fd, bool fresh) noexcept;

  /// A window as reported to a new daemon.
  struct Window {
    std::uint64_t base;
    std::uint64_t length;
    std::uint64_t first;  // of its window set
    int write_fd;         // owned by the heap
  };
  static std::uint64_t window_count() noexcept;
  static Window window(std::uint64_t number) noexcept;
  /// Describes the windows in one more client region, and stores frontiers there from now on.
  /// Returns false if there are too many regions already.
  [[nodiscard]] static bool follow(std::byte* client_region) noexcept;
  /// Stops storing frontiers in a region; nothing of it is touched afterwards. Waits for a growth
  /// in progress. Does nothing for a region that was never added. For library threads.
  static void leave_region(std::byte* client_region) noexcept;

  /// From now on a full heap counts as unable to grow.
  void no_more_windows() noexcept;
  bool has_last_window() const noexcept;
  /// Returns whether three quarters of the newest window are used, or a request did not fit.
  bool wants_window() const noexcept;
  std::uint64_t used_bytes() const noexcept;
  struct Room {
    std::uint64_t bytes;      // maximum in use so far: of a heap that refuses, its whole capacity
    std::uint64_t refused;    // allocations without room so far: see the hook's refused_count
    std::uint64_t bytes_max;  // of all windows that it may have, each as long as the present ones
  };
  Room room() const noexcept;

  /// Scopes of the calling thread, and its pauses, which override scopes; both nest.
  void enter() const noexcept { hook_->enter(); }
  void leave() const noexcept { hook_->leave(); }
  void pause() const noexcept;
  void resume() const noexcept;

  /// Returns scopes and windows of this heap, for make_resident.
  SharedHeap shared_heap() const noexcept;
  const agnocast_heaphook_table& hook() const noexcept { return *hook_; }

 private:
  explicit Heap(const agnocast_heaphook_table* hook) noexcept : hook_(hook) {}

  const agnocast_heaphook_table* hook_;
};

}  // namespace agnocast
