// SPDX-License-Identifier: Apache-2.0
//
// Controls which allocations go to the shared heap. Everything here is optional: a message that
// one thread borrows, fills and publishes is allocated there anyway.
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/ipc_shared_ptr.hpp>
#include <agnocast/result.hpp>

#include <cstdint>

namespace agnocast {

/// Which allocations of a process go to its shared heap once it has a publisher. Without the heap
/// hook none do, in either scope: messages are copied.
enum class HeapScope : std::uint8_t {
  loan,  ///< Those of a thread while it has a loan open. The default.
  all,   ///< All: a message made anywhere is published without a copy. Such a process must not
         ///< fork without exec. Everything it allocates counts against its heap quota and is
         ///< readable by its subscribers.
};

/// Chooses the scope. Call it before creating the first publisher, which opens the heap; earlier
/// allocations stay private. AGNOCAST_SCOPE=loan|all in the environment overrides it: the person
/// that starts the process decides. Errors: invalid_argument: the heap is open with the other
/// scope. Any thread.
[[nodiscard]] AGNOCAST_PUBLIC Result<void> set_heap_scope(HeapScope scope) noexcept;

/// Extends a loan to another thread: while this object lives, the calling thread allocates from
/// the shared heap, so that it can fill the message too. Also for a loan set aside with
/// Publisher::pause(). Nests. Destroy it in the thread that made it; the loan may be published
/// before. A few instructions, no system call.
///
///     auto loan = publisher->borrow_loaned_message();
///     loan->points.resize(4);
///     #pragma omp parallel for
///     for (int i = 0; i < 4; ++i) {
///       agnocast::LoanScope scope(loan);
///       loan->points[i].assign(1000, i);
///     }
class LoanScope {
 public:
  template <class T>
  explicit LoanScope(const ipc_shared_ptr<T>& loan) noexcept : is_open_(is_loan(loan) && open()) {}
  LoanScope(const LoanScope&) = delete;
  LoanScope& operator=(const LoanScope&) = delete;
  ~LoanScope() {
    if (is_open_) close();
  }
  /// Returns false if this object has no effect: the argument is no loan (empty, published, or a
  /// received message), agnocast is switched off, or the process has no heap hook.
  bool is_open() const noexcept { return is_open_; }

 private:
  friend class SharedHeapScope;
  template <class T>
  static bool is_loan(const ipc_shared_ptr<T>& loan) noexcept {
    return loan && loan.block()->lender != 0;
  }
  AGNOCAST_PUBLIC static bool open() noexcept;
  AGNOCAST_PUBLIC static void close() noexcept;

  bool is_open_;
};

/// Makes the calling thread allocate from the shared heap without a loan while this object lives:
/// for messages made before their publisher is known (in a bridge). Any publisher of this process
/// publishes such a message without a copy. Nests. Destroy it in the thread that made it. A few
/// instructions, no system call.
class SharedHeapScope {
 public:
  SharedHeapScope() noexcept : is_open_(begin()) {}
  SharedHeapScope(const SharedHeapScope&) = delete;
  SharedHeapScope& operator=(const SharedHeapScope&) = delete;
  ~SharedHeapScope() {
    if (is_open_) end();
  }
  /// Returns false if this object has no effect: the process has no heap hook, or no shared heap
  /// yet, because it has no publisher, or agnocast is switched off.
  bool is_open() const noexcept { return is_open_; }

 private:
  AGNOCAST_PUBLIC static bool begin() noexcept;
  AGNOCAST_PUBLIC static void end() noexcept;

  bool is_open_;
};

/// Makes the calling thread's allocations private while this object lives, whatever its open
/// loans and the scope of the heap: for working memory between borrow and publish. Publishing is
/// allowed meanwhile; a message borrowed meanwhile is adopted. Nests. Destroy it in the thread
/// that made it. A few instructions, no system call.
class LoanPause {
 public:
  LoanPause() noexcept : is_pause_(begin()) {}
  LoanPause(const LoanPause&) = delete;
  LoanPause& operator=(const LoanPause&) = delete;
  ~LoanPause() {
    if (is_pause_) end();
  }

 private:
  AGNOCAST_PUBLIC static bool begin() noexcept;
  AGNOCAST_PUBLIC static void end() noexcept;

  bool is_pause_;  // false: the process has no shared heap yet
};

}  // namespace agnocast
