// SPDX-License-Identifier: Apache-2.0
//
// MemoryReserve: memory that the daemon's loop still has when the system gives it no more.
//
// The daemon refuses a request that needs memory which is not there, and must complete what it has
// begun: once a change is in the redo log, the tables, the board and the derived data have to
// agree. So the loop has two kinds of allocations:
//
//   usual                    a failure takes a piece out of the reserve and goes on
//   inside MayFail           a failure throws std::bad_alloc; the creator of the MayFail catches it
//   … after no_return()      usual again, up to the end of the outermost MayFail
//
// Registry::change() is a point of no return, and so is every other step that an exception cannot
// undo. The daemon fills the reserve before each request, each connection and each end of one;
// while that fails, it refuses requests and connections unread, so each begins with a full reserve.
// Data of one event that can grow without bound has a MayFail of its own: packets (the client that
// reads them loses its connection) and dumps (likewise). If the reserve is used up all the same,
// the daemon aborts and is started again, as after any death.
//
// The reserve belongs to one thread: allocations of other threads fail as usual.
#pragma once

#include <cstddef>
#include <string_view>
#include <utility>

namespace agnocast::daemon {

inline constexpr std::string_view no_memory_text = "agnocastd has no memory left";

class MemoryReserve {
 public:
  // Several times what the longest change takes: an endpoint that is announced to 1,022 others.
  static constexpr std::size_t piece_count = 64, piece_bytes = 64 * 1024;

  /// Installs the reserve for the calling thread and fills it. Call once.
  static void install() noexcept;
  /// Fills the reserve again. Returns false when it is not full, true when none is installed.
  [[nodiscard]] static bool refill() noexcept;

  /// While it exists, an allocation of this thread may fail.
  class MayFail {
   public:
    MayFail() noexcept : before_(std::exchange(may_fail_, true)) {}
    ~MayFail() { may_fail_ = before_; }
    MayFail(const MayFail&) = delete;
    MayFail& operator=(const MayFail&) = delete;

   private:
    bool before_;
  };
  /// While it exists inside a MayFail, allocations use the reserve again.
  class MustNotFail {
   public:
    MustNotFail() noexcept : before_(std::exchange(may_fail_, false)) {}
    ~MustNotFail() { may_fail_ = before_; }
    MustNotFail(const MustNotFail&) = delete;
    MustNotFail& operator=(const MustNotFail&) = delete;

   private:
    bool before_;
  };
  static void no_return() noexcept { may_fail_ = false; }

 private:
  static void on_failure();

  static thread_local constinit bool may_fail_, is_installed_;
};

}  // namespace agnocast::daemon
