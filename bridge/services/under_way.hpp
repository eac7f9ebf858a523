// SPDX-License-Identifier: Apache-2.0
//
// UnderWay: the requests that a server here has got and not answered. A server drops answers of which the bridge has not
// read as many as the server is deep, so no more requests than that are under way, unless they have taken longer than
// `patience` and so are not about to be answered all at once. A server that never answers shall not cost memory without
// end: of too many the oldest is forgotten, and one more is under way for it.
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

/// One thread's; completions may end on any.
class UnderWay {
 public:
  using Time = std::chrono::steady_clock::time_point;
  static constexpr std::size_t unanswered_max = 1'000;
  /// As deep as servers are that say nothing else.
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
  /// One more, after has_room(), unanswered while its completion is there. The one to forget, if they are too many.
  std::optional<std::int64_t> add(std::int64_t request, std::weak_ptr<const void> completion,
                                  Time now) {
    sent_.push_back({request, std::move(completion)});
    newest_ = now;
    if (sent_.size() <= unanswered_max) return std::nullopt;
    const std::int64_t oldest = sent_.front().request;
    sent_.pop_front();
    --slow_;  // it was one of them
    return oldest;
  }
  /// When the last one was sent.
  Time newest() const noexcept { return newest_; }

 private:
  struct Sent {
    std::int64_t request;
    std::weak_ptr<const void> completion;
  };
  std::deque<Sent> sent_;
  std::size_t slow_ = 0;  // how many of them are not waited for: the oldest
  Time newest_;
};

}  // namespace agnocast::bridge
