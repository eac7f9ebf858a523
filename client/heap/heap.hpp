// SPDX-License-Identifier: Apache-2.0
//
// Heap: this process's shared heap, through the heap hook. Found by name at run time: a process
// without the hook can subscribe, not publish.
#pragma once

#include <agnocast/abi/heaphook.h>
#include <agnocast/heap.hpp>
#include <agnocast/residency.hpp>
#include <agnocast/result.hpp>
#include <base/unique_fd.hpp>

#include <cstddef>
#include <cstdint>

namespace agnocast {

class Heap {
 public:
  /// Looks for the hook. Errors: hook_missing (none in this process, or one of another version).
  [[nodiscard]] static Result<Heap> find();

  /// The first window. `client_region`: where the frontier is stored; `grown`: called after it was,
  /// without locks of ours, must not allocate. Errors: hook_missing, arena_occupied, lock_limit,
  /// os_failure.
  [[nodiscard]] Result<void> attach(std::byte* client_region, std::uint64_t base,
                                    std::uint64_t length, UniqueFd write_fd, int read_fd,
                                    HeapScope scope, void (*grown)() noexcept);
  /// Whether ordinary allocations in a scope come from this heap; found out by attach. Errors:
  /// hook_ineffective (malloc or new are not the hook's: somebody else replaced them).
  [[nodiscard]] Result<void> check_interposition() const;
  /// The next window; a `fresh` one is the only one to allocate from, and to publish from, from now
  /// on, until others are added.
  [[nodiscard]] Result<void> add_window(std::byte* client_region, std::uint64_t window,
                                        std::uint64_t base, std::uint64_t length, UniqueFd write_fd,
                                        int read_fd, bool fresh) noexcept;

  /// A window as another daemon is told of it.
  struct Window {
    std::uint64_t base;
    std::uint64_t length;
    std::uint64_t first;  // of its group
    int write_fd;         // the heap's
  };
  static std::uint64_t window_count() noexcept;
  static Window window(std::uint64_t number) noexcept;
  /// The windows are described in one more client region, and frontiers are stored there from now on.
  /// False: in too many already.
  [[nodiscard]] static bool follow(std::byte* client_region) noexcept;
  /// No longer: afterwards nothing of it is touched. Waits for a growth that is under way. Nothing
  /// happens if it is not followed. For threads of the library.
  static void leave_region(std::byte* client_region) noexcept;

  /// Whoever finds the heap full from now on is told that it will not grow.
  void no_more_windows() noexcept;
  bool has_last_window() const noexcept;
  /// True when the newest window is used to three quarters, or a request did not fit.
  bool wants_window() const noexcept;
  std::uint64_t used_bytes() const noexcept;
  struct Room {
    std::uint64_t bytes;    // that were in use at one time: of a heap that refuses, all it can have
    std::uint64_t refused;  // allocations that found none, since ever: see the hook's refused_count
    std::uint64_t bytes_max;  // in all windows that it may have, were each as long as those it has
  };
  Room room() const noexcept;

  /// The calling thread's scopes, and its pauses, which win over scopes; both nest.
  void enter() const noexcept { hook_->enter(); }
  void leave() const noexcept { hook_->leave(); }
  void pause() const noexcept;
  void resume() const noexcept;

  /// What make_resident needs: scopes and windows of this heap.
  SharedHeap shared_heap() const noexcept;
  const agnocast_heaphook_table& hook() const noexcept { return *hook_; }

 private:
  explicit Heap(const agnocast_heaphook_table* hook) noexcept : hook_(hook) {}

  const agnocast_heaphook_table* hook_;
};

}  // namespace agnocast
