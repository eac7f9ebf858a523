// SPDX-License-Identifier: Apache-2.0
//
// WaitSetPlaces: the places of the wait sets of this process in one session. Each is a sleep word
// in the client region and the doorbells that ring for it, by number.
//
//   never asked for ──▶ lent to a wait set ◀──▶ unused, with its doorbells
//          └── refused, or no answer in time ──▶ failed: asked for once more before a new number is
//
// A returned place is kept: it stays the process's, with its doorbells, and its sleep word goes on
// counting. It returns wherever its last user is destroyed, so the mutex of the places is
// innermost. This object must outlive every place.
#pragma once

#include <agnocast/result.hpp>
#include <base/descriptors/doorbell.hpp>
#include <client/process/wait_set.hpp>

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <vector>

namespace agnocast {

class WaitSetPlaces {
 public:
  /// Asks the daemon for the doorbells of a wait set. `again`: the daemon may have opened it for
  /// an earlier request.
  using Open =
      std::function<Result<std::unique_ptr<WaitSet::Place>>(std::uint64_t wait_set, bool again)>;
  /// Returns whether the session has a daemon that could open one.
  using Permit = std::function<Result<void>()>;

  // --- any thread

  /// Gives the wait set a place in the session, unless it has one. Calls `permit` first, while no
  /// other thread gets a place. Errors: limit_reached, those of `permit` and `open`, os_failure.
  [[nodiscard]] Result<void> give(WaitSet& wait_set, WaitSet::Session session, const Permit& permit,
                                  const Open& open);

  // --- control thread

  /// Swaps the doorbells of an unused place with `doorbells`.
  void renew(std::uint64_t wait_set, DoorbellReceiver& doorbells) noexcept;
  /// Ends the unused places for good. Returns false, and does nothing, while any place is lent.
  bool end() noexcept;

 private:
  /// The next place to give: an unused one, or a number and whether it was asked for before.
  struct Next {
    std::unique_ptr<WaitSet::Place> place;
    std::uint64_t wait_set = 0;
    bool again = false;
  };
  Result<Next> next();
  std::shared_ptr<WaitSet::Place> lend(std::unique_ptr<WaitSet::Place> place);

  std::mutex giving_;  // one at a time, so that a wait set has one place here
  std::mutex mutex_;   // innermost
  std::uint64_t next_number_ = 0;
  std::uint64_t lent_ = 0;
  std::vector<std::unique_ptr<WaitSet::Place>> unused_;
  std::vector<std::uint64_t> failed_;  // numbers whose doorbells never came
};

}  // namespace agnocast
