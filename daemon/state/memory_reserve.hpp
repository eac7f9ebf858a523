// SPDX-License-Identifier: Apache-2.0
//
// MemoryReserve: what the daemon's loop still has when the system gives it no memory any more.
//
// A request that needs memory which is not there is to be refused, and what was begun is to be
// brought to its end: once a change is in the redo log, tables, board and what is derived from them
// have to say the same. So allocations of the loop are of two kinds:
//
//   usual                    a failure takes a piece out of the reserve and goes on
//   inside MayFail           a failure is std::bad_alloc, for whoever made the MayFail to catch
//   … after no_return()      usual again, up to the end of the outermost MayFail
//
// Registry::change() is a point of no return, and so is whatever else cannot be undone by leaving
// it. The reserve is filled up before each request and each connection; while that fails, they are
// refused before they are looked at, so each begins with all of it. What one event can allocate
// without end is a MayFail of its own: packets (their reader loses its connection) and dumps
// (likewise). When the reserve is used up all the same, the daemon aborts and is started again, as
// after any death.
//
// Of one thread: allocations of others fail as they always do.
#pragma once

#include <cstddef>
#include <string_view>
#include <utility>

namespace agnocast::daemon {

inline constexpr std::string_view no_memory_text = "agnocastd has no memory left";

class MemoryReserve {
 public:
  // Several times what the longest change takes: an endpoint that 1,022 others are told of.
  static constexpr std::size_t piece_count = 64, piece_bytes = 64 * 1024;

  /// From now on, for the calling thread. Fills the reserve. Once.
  static void install() noexcept;
  /// Puts back what was taken. False: it is not whole. True where none is installed.
  [[nodiscard]] static bool refill() noexcept;

  /// As long as it exists an allocation of this thread may fail.
  class MayFail {
   public:
    MayFail() noexcept : before_(std::exchange(may_fail_, true)) {}
    ~MayFail() { may_fail_ = before_; }
    MayFail(const MayFail&) = delete;
    MayFail& operator=(const MayFail&) = delete;

   private:
    bool before_;
  };
  /// Inside a MayFail: not here.
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
