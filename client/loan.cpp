// SPDX-License-Identifier: Apache-2.0
//
// Loan scopes: how a thread allocates from the shared heap from borrow to publish.

#include <agnocast/heap.hpp>
#include <agnocast/publisher.hpp>
#include <client/context.hpp>

#include <atomic>
#include <new>
#include <utility>

namespace agnocast {

Result<void> set_heap_scope(HeapScope scope) noexcept {
  return Context::instance().set_heap_scope(scope);
}

}  // namespace agnocast

namespace agnocast::detail {

/// One per thread that ever borrowed; outlives the thread as long as one of its loans does.
struct LoanScope::Home {
  std::atomic<std::uint64_t> owed{0};   // leaves that other threads could not do for it
  std::atomic<std::uint64_t> users{1};  // the thread, and its open loans

  void let_go() noexcept {
    if (users.fetch_sub(1, std::memory_order_acq_rel) == 1) delete this;
  }
  void pay(const SharedHeap& heap) noexcept {
    for (std::uint64_t n = owed.exchange(0, std::memory_order_acquire); n > 0; --n)
      heap.leave(heap.context);
  }
};

namespace {

template <class Home>
struct ThreadHome {
  Home* home = nullptr;
  ~ThreadHome() {
    if (home != nullptr) home->let_go();
  }
};

}  // namespace

void LoanScope::open() noexcept {
  static thread_local ThreadHome<Home> mine;
  if (mine.home == nullptr) mine.home = new (std::nothrow) Home;
  if (mine.home == nullptr)
    return;  // no memory: the loan is built on the ordinary heap and adopted at publish
  current() = mine.home;
  const SharedHeap heap = Context::instance().shared_heap();
  mine.home->pay(heap);
  mine.home->users.fetch_add(1, std::memory_order_relaxed);
  home_ = mine.home;
  heap.enter(heap.context);
}

LoanScope::Home*& LoanScope::current() noexcept {
  static thread_local Home* home = nullptr;
  return home;
}

void LoanScope::close() noexcept {
  Home* const home = std::exchange(home_, nullptr);
  if (home == nullptr) return;
  if (current() == home) {
    const SharedHeap heap = Context::instance().shared_heap();
    heap.leave(heap.context);
    home->pay(heap);
  } else {
    home->owed.fetch_add(1, std::memory_order_release);
  }
  home->let_go();
}

}  // namespace agnocast::detail
