// SPDX-License-Identifier: Apache-2.0
//
// Work: one call on the queue of a PublisherEndpoint, for the files that implement it. The call
// runs under its mutex and leaves work for the time after: doorbells beyond the first two, and
// messages to be destroyed, whose destructors are user code.
#pragma once

#include <client/endpoint/publisher_endpoint.hpp>
#include <client/process/steps.hpp>
#include <client/process/user_code.hpp>

#include <array>
#include <cstddef>
#include <cstdint>
#include <mutex>

namespace agnocast {

/// What one call on the queue leaves to do outside the mutex.
struct PublisherEndpoint::Work {
  Work(PublisherEndpoint& of, bool destroys) noexcept : endpoint(of), may_destroy(destroys) {}

  PublisherEndpoint& endpoint;
  const bool may_destroy;                          // otherwise messages die with the process
  std::array<void*, destroy_at_once_max> destroy;  // the first destroy_count
  std::size_t destroy_count = 0;
  std::uint64_t rung = 0;
  bool wake_control = false;
  bool destroys_later = false;

  /// Counts the bytes in the cache line that the commit writes next: written after the commit, the
  /// count would take the line a second time from the readers. Only written under the mutex. A
  /// death in between leaves the counter one message ahead, which is harmless: only people read it.
  void commits(const dataplane::Entry& entry) noexcept {
    auto& total =
        endpoint.identity_.core.words.counter(offsetof(abi::PublisherEndpoint, published_bytes));
    total.store(total.load(std::memory_order_relaxed) + entry.bytes, std::memory_order_relaxed);
  }
  void ring(std::uint64_t number, [[maybe_unused]] std::uint64_t armed) noexcept {
    PeerWaitSet& wait_set = endpoint.wait_sets_[number];
    if (!wait_set.doorbell.sender) return;
    if (rung++ < ring_at_once_max) {
      wait_set.doorbell.sender.ring();
    } else {
      wait_set.is_owed_ring = true;
      wake_control = true;
    }
  }
  /// Returns whether the control thread is about to scan, because it is woken anyway. It destroys
  /// nothing once exit has begun.
  bool scans_soon() const noexcept { return wake_control && !exit_has_begun(); }
  void freed(std::uint64_t, std::uint64_t address) noexcept {
    if (!may_destroy) return;
    void* const message = reinterpret_cast<void*>(address);
    if (!destroys_later && destroy_count < destroy.size()) {
      destroy[destroy_count++] = message;
    } else if (endpoint.doomed_.size() == endpoint.doomed_.capacity()) {
      // The control thread is far behind: destroy here, under the mutex, rather than allocate.
      const UserSignals as_creator(endpoint.identity_.signals);
      endpoint.destroy(message);
    } else {
      endpoint.doomed_.push_back(message);  // within its capacity: no allocation
      endpoint.has_doomed_.store(true, std::memory_order_relaxed);
    }
  }
  /// Destroys messages that an earlier call had no room for.
  void destroy_doomed() noexcept {
    if (!may_destroy) return;
    auto& doomed = endpoint.doomed_;
    for (; !doomed.empty() && destroy_count < destroy.size(); doomed.pop_back())
      destroy[destroy_count++] = doomed.back();
    if (doomed.empty() && !endpoint.lacked_room_.load(std::memory_order_relaxed))
      endpoint.has_doomed_.store(false, std::memory_order_relaxed);
  }
};

template <class Do>
inline void PublisherEndpoint::run_locked(Do work, Work& left) noexcept {
  {
    const std::lock_guard lock(mutex_);
    work(left);
  }
  if (left.wake_control) identity_.wake_control();  // first: wait sets do not wait for destructors
}

inline void PublisherEndpoint::destroy_all(const Work& left) noexcept {
  for (std::size_t i = 0; i < left.destroy_count; ++i) {
    AGNOCAST_CRASH_POINT(C_destroy);
    destroy(left.destroy[i]);
  }
}

template <class Do>
void PublisherEndpoint::with_queue(Do work) noexcept {
  Work left(*this, true);
  run_locked(work, left);
  destroy_all(left);
}

template <class Do>
void PublisherEndpoint::in_control_thread(Do work) noexcept {
  const UserCode code;
  Work left(*this, code.may_run());
  run_locked(work, left);
  if (left.destroy_count == 0) return;
  const UserSignals as_creator(identity_.signals);
  destroy_all(left);
}

}  // namespace agnocast
