// SPDX-License-Identifier: Apache-2.0
//
// Wait set: threads of this process sleep on it until a publisher rings.
//
// Several threads may sleep on it at once, each in an epoll set of its own: a ring ends all their
// sleeps, and each looks whether there is something for it.
//
// It has a *place* in each session of the process: a sleep word in the client region and two
// doorbells. Usually there is one session. After the daemon's store was lost there are two for a
// while, and a ring in either ends the sleep. Adding or removing a place ends the sleep as well,
// so no thread sleeps on half of the doorbells. It may have no place for a moment: the process
// wakes itself through an eventfd of its own, which no other process has.
#pragma once

#include <base/descriptors/doorbell.hpp>
#include <base/descriptors/unique_fd.hpp>
#include <dataplane/subscription_core.hpp>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

namespace agnocast {

class WaitSet {
 public:
  /// Its place in one session.
  struct Place {
    Place(std::byte* client_region, std::uint64_t number, DoorbellReceiver receiver) noexcept
        : index(number),
          doorbells(std::move(receiver)),
          core(client_region,
               offsetof(abi::ClientRegionHeader, wait_set) + number * sizeof(abi::WaitSetLine)) {}
    std::uint64_t index;
    DoorbellReceiver doorbells;
    dataplane::SleepCore<SharedMemory> core;
    bool is_armed = false;  // at least one thread sleeps
  };
  /// A session is identified by an address.
  using Session = const void*;

  /// Makes a wait set without places. Errors: os_failure.
  [[nodiscard]] static Result<std::shared_ptr<WaitSet>> make();
  explicit WaitSet(UniqueFd eventfd) noexcept : eventfd_(std::move(eventfd)) {}
  WaitSet(const WaitSet&) = delete;
  WaitSet& operator=(const WaitSet&) = delete;
  ~WaitSet();

  // --- any thread

  /// Adds a place. Errors: os_failure; then nothing was added.
  [[nodiscard]] Result<void> add(Session session, std::shared_ptr<Place> place);
  /// Removes the place of a session. Does nothing if there is none.
  void remove(Session session) noexcept;
  /// Replaces the doorbells of a place and returns the old ones in `doorbells`. Returns false if
  /// there is no place, or the system refuses to watch them.
  bool renew(Session session, DoorbellReceiver& doorbells) noexcept;
  std::optional<std::uint64_t> index_in(Session session) const noexcept;

  /// Adds all doorbells, also future ones, to this epoll set until remove_from(). Errors:
  /// os_failure.
  [[nodiscard]] Result<void> add_to(int epoll, std::uint64_t eventfd_tag,
                                    std::uint64_t datagram_tag);
  void remove_from(int epoll) noexcept;
  /// Call it when a datagram doorbell rang. Wakes the other epoll sets: what empties the socket
  /// for one takes its ring away from all.
  void drain() noexcept;
  /// Ends the sleep from inside the process: for a new link, a window, a dead publisher.
  void wake() const noexcept;

  // --- a thread that sleeps. Order: arm, check every subscription, block on the doorbells, disarm
  // once.

  void arm() noexcept;
  void disarm() noexcept;

 private:
  struct Set {
    int epoll;
    std::uint64_t eventfd_tag, datagram_tag;
  };
  void leave(int epoll) const noexcept;  // under the mutex, like the next
  void disarm_places() noexcept;

  const UniqueFd eventfd_;    // in every set, edge-triggered, never read
  mutable std::mutex mutex_;  // innermost
  std::vector<std::pair<Session, std::shared_ptr<Place>>> places_;
  std::vector<Set> sets_;
  std::size_t asleep_ = 0;  // threads between arm() and disarm()
};

}  // namespace agnocast
