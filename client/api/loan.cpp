// SPDX-License-Identifier: Apache-2.0
//
// Scopes of the shared heap: which allocations of a thread are shared, from borrow to publish and
// inside explicit scopes.

#include <agnocast/heap.hpp>
#include <agnocast/publisher.hpp>
#include <client/session/context.hpp>

#include <atomic>
#include <new>
#include <utility>

namespace agnocast {

Result<void> set_heap_scope(HeapScope scope) noexcept {
  return Context::instance().set_heap_scope(scope);
}

bool LoanScope::open() noexcept {
  const Heap* const heap = Context::instance().heap();
  if (heap == nullptr || heap->copies()) return false;  // switched off, or without the hook
  heap->enter();
  return true;
}
void LoanScope::close() noexcept { Context::instance().heap()->leave(); }

bool SharedHeapScope::begin() noexcept { return LoanScope::open(); }
void SharedHeapScope::end() noexcept { LoanScope::close(); }

bool LoanPause::begin() noexcept {
  const Heap* const heap = Context::instance().heap();
  if (heap == nullptr) return false;
  heap->pause();
  return true;
}
void LoanPause::end() noexcept { Context::instance().heap()->resume(); }

namespace detail {

LenderId::LenderId() noexcept {
  static constinit std::atomic<std::uint64_t> last{0};
  value_ = last.fetch_add(1, std::memory_order_relaxed) + 1;
}

/// One per thread that ever borrowed; outlives the thread as long as one of its loans does.
struct BorrowScope::Home {
  static constexpr std::uint64_t thread_lives = std::uint64_t{1} << 63;

  std::atomic<std::uint64_t> owed{0};  // leaves that other threads could not do for it
  std::uint64_t open = 0;              // loans that the thread has not closed; only for the thread
  // Reference count: other threads subtract the loans that they close, and the thread subtracts
  // the rest of thread_lives when it ends. So the thread's own loans, nearly all, need no locked
  // instruction.
  std::atomic<std::uint64_t> left{thread_lives};

  void release(std::uint64_t part) noexcept {
    if (left.fetch_sub(part, std::memory_order_acq_rel) == part) delete this;
  }
  void pay(const Heap& heap) noexcept {
    if (owed.load(std::memory_order_relaxed) == 0) [[likely]]
      return;
    for (std::uint64_t n = owed.exchange(0, std::memory_order_acquire); n > 0; --n) heap.leave();
  }
};

void BorrowScope::open() noexcept {
  // Destructors of other thread data, and static objects after those of the main thread, may
  // still borrow: they get a new home, which is never freed.
  struct LeavesHome {
    ~LeavesHome() {
      if (Home* const home = std::exchange(current(), nullptr); home != nullptr)
        home->release(Home::thread_lives - home->open);
    }
  };
  const Heap* const heap = Context::instance().heap();
  if (heap == nullptr || heap->copies()) return;  // switched off, or without the hook
  Home*& mine = current();
  if (mine == nullptr) {
    mine = new (std::nothrow) Home;
    static thread_local const LeavesHome at_thread_end;
  }
  if (mine == nullptr)
    return;  // no memory: the loan is built on the ordinary heap and adopted at publish
  mine->pay(*heap);
  ++mine->open;
  home_ = mine;
  heap->enter();
}

BorrowScope::Home*& BorrowScope::current() noexcept {
  static thread_local Home* home = nullptr;
  return home;
}

void BorrowScope::close() noexcept {
  Home* const home = std::exchange(home_, nullptr);
  if (home == nullptr) return;
  if (current() == home) {
    const Heap& heap = *Context::instance().heap();
    heap.leave();
    home->pay(heap);
    --home->open;
  } else {
    home->owed.fetch_add(1, std::memory_order_release);
    home->release(1);
  }
}

}  // namespace detail
}  // namespace agnocast
