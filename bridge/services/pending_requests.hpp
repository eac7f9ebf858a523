// SPDX-License-Identifier: Apache-2.0
//
// PendingRequests: the requests that a server here has received and not answered. A server drops
// unread answers beyond its depth, so no more requests than that are pending at once, except those
// that take longer than `patience`, whose answers will not come all together. A server that never
// answers must not cost unlimited memory: of too many, the oldest is dropped, and one more may be
// pending for it.
#pragma once

#include <agnocast/agnocast.hpp>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <utility>

namespace agnocast::bridge {

/// One thread; the owners of completions may end on any thread.
class PendingRequests {
 public:
  using Time = std::chrono::steady_clock::time_point;
  static constexpr std::size_t unanswered_max = 1'000;
  /// The default depth of servers.
  static std::size_t at_once_max() noexcept { return ServicesQoS().depth(); }
  static constexpr std::chrono::seconds patience{1};

  bool has_room(Time now) {
    std::size_t at = 0, slow = 0;
    std::erase_if(sent_, [&](const Sent& each) {
      const bool is_slow = at++ < slow_, is_answered = each.completion.expired();
      slow += is_slow && !is_answered;
      return is_answered;
    });
    slow_ = slow;
    if (sent_.size() < slow_ + at_once_max()) return true;
    if (now < newest_ + patience) return false;
    slow_ = sent_.size();
    return true;
  }
  /// Adds a request, after has_room(), pending while its completion lives. Returns one to drop if
  /// there are too many.
  std::optional<std::int64_t> add(std::int64_t request, std::weak_ptr<const void> completion,
                                  Time now) {
    sent_.push_back({request, std::move(completion)});
    newest_ = now;
    if (sent_.size() <= unanswered_max) return std::nullopt;
    const std::int64_t oldest = sent_.front().request;
    sent_.pop_front();
    --slow_;  // the oldest was a slow one
    return oldest;
  }
  /// Returns when the last one was sent.
  Time newest() const noexcept { return newest_; }

 private:
  struct Sent {
    std::int64_t request;
    std::weak_ptr<const void> completion;
  };
  std::deque<Sent> sent_;
  std::size_t slow_ = 0;  // the oldest ones, which are no longer waited for
  Time newest_;
};

}  // namespace agnocast::bridge
