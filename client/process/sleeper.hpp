// SPDX-License-Identifier: Apache-2.0
//
// Sleeper: something of this process that sleeps until a publisher rings.
//
// It has a *place* in each membership of the process: a sleep word in the client region and two
// bells. Usually that is one. After the daemon's store was lost it is two for a while, and a sleep is
// ended by whoever rings in either. A place that comes or goes ends the sleep as well, so nobody
// sleeps on half of the bells. It may be none for a moment: what the process itself has to say comes through
// an eventfd of its own, which no other process has.
#pragma once

#include <base/doorbell.hpp>
#include <base/unique_fd.hpp>
#include <dataplane/subscription_core.hpp>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

namespace agnocast {

class Sleeper {
 public:
  /// In one membership.
  struct Place {
    Place(std::byte* client_region, std::uint64_t number, DoorbellReceiver receiver) noexcept
        : index(number),
          bells(std::move(receiver)),
          core(client_region,
               offsetof(abi::ClientRegionHeader, executor) + number * sizeof(abi::ExecutorLine)) {}
    std::uint64_t index;
    DoorbellReceiver bells;
    dataplane::SleepCore<SharedMemory> core;
    bool is_armed = false;
  };
  /// A membership is known by an address.
  using Membership = const void*;

  /// Errors: os_failure.
  [[nodiscard]] static Result<std::shared_ptr<Sleeper>> make();
  explicit Sleeper(UniqueFd eventfd) noexcept : eventfd_(std::move(eventfd)) {}
  Sleeper(const Sleeper&) = delete;
  Sleeper& operator=(const Sleeper&) = delete;
  ~Sleeper();

  // --- any thread

  /// Errors: os_failure; then it has no such place.
  [[nodiscard]] Result<void> add(Membership membership, std::shared_ptr<Place> place);
  /// The place is let go of. Nothing happens if there is none.
  void remove(Membership membership) noexcept;
  /// Other bells for the place that it has there; those that it had are in `bells` afterwards. False: it has none,
  /// or the system refuses to watch them.
  bool renew(Membership membership, DoorbellReceiver& bells) noexcept;
  std::optional<std::uint64_t> index_in(Membership membership) const noexcept;

  /// All bells, also those to come, are in this epoll set until remove_from(). Errors: os_failure.
  [[nodiscard]] Result<void> add_to(int epoll, std::uint64_t eventfd_tag,
                                    std::uint64_t datagram_tag);
  void remove_from(int epoll) noexcept;
  /// A datagram bell rang.
  void drain() noexcept;
  /// Ends the sleep from inside the process: a new link, a window, a publisher that is gone.
  void wake() const noexcept;

  // --- one thread. Order: arm, look at every subscription, block on the bells, disarm.

  void arm() noexcept;
  void disarm() noexcept;

 private:
  struct Set {
    int epoll;
    std::uint64_t eventfd_tag, datagram_tag;
  };
  void leave(int epoll) const noexcept;  // under the mutex

  const UniqueFd eventfd_;    // in every set, edge-triggered, never read
  mutable std::mutex mutex_;  // innermost
  std::vector<std::pair<Membership, std::shared_ptr<Place>>> places_;
  std::vector<Set> sets_;
};

}  // namespace agnocast
