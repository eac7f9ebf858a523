// SPDX-License-Identifier: Apache-2.0
//
// Lender: lends messages to fill and takes them back, for publishers, clients and services. From
// borrow to publish the borrowing thread allocates from the shared heap.
#pragma once

#include <agnocast/error.hpp>
#include <agnocast/export.hpp>
#include <agnocast/ipc_shared_ptr.hpp>

#include <atomic>
#include <cstdint>
#include <memory>
#include <utility>

namespace agnocast {

/// Outcome of publish. Converts to true when the message was committed and belongs to the queue;
/// otherwise the caller still owns it.
struct PublishResult {
  /// ok, no_slot, would_block, heap_exhausted, window_exhausted, loan_invalid, user_code_threw,
  /// protocol_violation, shut_down (in a forked child), switched_off, revoked
  Errc code = Errc::ok;
  std::uint64_t adopted_bytes =
      0;  ///< bytes outside the shared heap that had to be copied in; 0 = true zero-copy
  explicit operator bool() const noexcept { return code == Errc::ok; }
};

namespace detail {

/// Keeps one thread's allocations in the shared heap from borrow to publish. Another thread may
/// close it: then the first thread is notified, and returns to its ordinary heap at its next
/// borrow or publish.
class AGNOCAST_PUBLIC BorrowScope {
 public:
  BorrowScope() noexcept = default;
  BorrowScope(const BorrowScope&) = delete;
  BorrowScope& operator=(const BorrowScope&) = delete;
  ~BorrowScope() { close(); }
  void open() noexcept;
  void close() noexcept;

 private:
  struct Home;
  static Home*& current() noexcept;  // of the calling thread
  Home* home_ = nullptr;
};

/// Distinguishes the loans of one publisher, service or client of this process from all others.
/// An address cannot: a loan may outlive its lender, and another lender be created at the same
/// address.
class LenderId {
 public:
  /// Makes a new id, unique in the process.
  AGNOCAST_PUBLIC LenderId() noexcept;
  std::uint64_t value() const noexcept { return value_; }

 private:
  std::uint64_t value_;  // counted from 1; they do not run out
};

/// Lends messages and takes them back. `Code` makes, copies, owns and measures messages of type
/// T: TypedCode, CodeByTable of generic.hpp, or those of service_message.hpp.
template <class T, class Code>
class Lender {
 public:
  using Owner = typename Code::Owner;  // a unique_ptr

  /// Suspends a loan that will be filled later: from now on the thread that borrowed it allocates
  /// as if it had not; LoanScope(loan) resumes. Call it before passing the loan to another thread
  /// that publishes it: that thread cannot end this one's scope, which then lasts until its next
  /// borrow. Returns false for a loan of another lender. Any thread, but not while another one
  /// publishes the same loan.
  bool pause(const ipc_shared_ptr<T>& message) noexcept {
    Loan* const loan = loan_of(message);
    if (loan == nullptr || loan->message == nullptr) return false;
    loan->scope.close();
    return true;
  }

 protected:
  Lender(LenderId id, Code code) noexcept : id_(id.value()), code_(code) {}
  ~Lender() = default;

  ipc_shared_ptr<T> lend() const {
    auto loan = std::make_unique<Loan>(code_);
    loan->lender = id_;
    loan->end = [](Block* block) noexcept { delete static_cast<Loan*>(block); };
    loan->scope.open();
    loan->message = code_.make().release();
    return ipc_shared_ptr<T>(loan.release());
  }
  /// Passes the loan to `commit_owned(Owner&&)`, which leaves it in place unless it succeeds.
  template <class Commit>
  PublishResult take_back(ipc_shared_ptr<T>&& message, Commit&& commit_owned) const noexcept {
    Loan* const loan = loan_of(message);
    if (loan == nullptr) return {Errc::loan_invalid, 0};
    Owner object = code_.own(static_cast<T*>(take_message(*loan)));
    if (object == nullptr) return {Errc::loan_invalid, 0};
    const PublishResult result = commit_owned(std::move(object));
    if (result) {
      loan->scope.close();
      message.reset();
    } else {
      loan->message.store(object.release(), std::memory_order_release);
    }
    return result;
  }
  const Code& code() const noexcept { return code_; }

 private:
  struct Loan : Block {
    explicit Loan(const Code& of) noexcept : code(of) {}
    ~Loan() { (void)code.own(static_cast<T*>(message.load(std::memory_order_relaxed))); }
    Code code;
    BorrowScope scope;  // closed after the message is gone: member order
  };
  /// Takes the message; only one of several copies of the handle gets it. A single copy has no
  /// rivals, and needs no locked instruction.
  static void* take_message(Loan& loan) noexcept {
    if (loan.users.load(std::memory_order_acquire) != 1)
      return loan.message.exchange(nullptr, std::memory_order_acq_rel);
    void* const message = loan.message.load(std::memory_order_relaxed);
    loan.message.store(nullptr, std::memory_order_relaxed);
    return message;
  }
  Loan* loan_of(const ipc_shared_ptr<T>& message) const noexcept {
    Block* const block = message.block();
    return block != nullptr && block->lender == id_ ? static_cast<Loan*>(block) : nullptr;
  }

  std::uint64_t id_;
  Code code_;
};

}  // namespace detail

}  // namespace agnocast
