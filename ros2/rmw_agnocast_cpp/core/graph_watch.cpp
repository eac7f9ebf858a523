// SPDX-License-Identifier: Apache-2.0

#include <ros2/rmw_agnocast_cpp/core/graph_watch.hpp>

#include <base/signals.hpp>

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <new>
#include <utility>

namespace agnocast::rmw {

GraphWatch::GraphWatch(std::uint64_t domain, std::function<void()> changed)
    : domain_(domain), changed_(std::move(changed)), process_(::getpid()), thread_([this] {
        const SignalsBlocked blocked;  // the thread inherits them
        return std::thread([this] { run(); });
      }()) {}

GraphWatch::~GraphWatch() {
  if (::getpid() != process_) {  // a forked child, where there is no such thread
    thread_.detach();
    return;
  }
  {
    const std::lock_guard lock(mutex_);
    is_over_ = true;
    came_.notify_all();
  }
  graph_.interrupt();
  thread_.join();
}

std::shared_ptr<const GraphSnapshot> GraphWatch::now() const {
  std::unique_lock lock(mutex_);
  if (!std::exchange(has_waited_, true))
    came_.wait_for(lock, std::chrono::seconds(1), [this] { return last_ != nullptr || is_over_; });
  return last_ != nullptr ? last_ : std::make_shared<const GraphSnapshot>();
}

/// Returns whether it differs from the last one.
bool GraphWatch::take(GraphSnapshot next) {
  std::erase_if(next.endpoints,
                [this](const EndpointInfo& endpoint) { return endpoint.domain != domain_; });
  const std::lock_guard lock(mutex_);
  const bool is_same =
      last_ != nullptr && last_->incarnation == next.incarnation &&
      std::equal(last_->endpoints.begin(), last_->endpoints.end(), next.endpoints.begin(),
                 next.endpoints.end(), [](const EndpointInfo& a, const EndpointInfo& b) {
                   return a.generation == b.generation && a.kind == b.kind;
                 });
  if (is_same) return false;
  last_ = std::make_shared<const GraphSnapshot>(std::move(next));
  came_.notify_all();
  return true;
}

void GraphWatch::run() noexcept {
  // After an error: how long until it connects again.
  constexpr auto pause = std::chrono::seconds(1);
  const auto is_over = [this] {
    const std::lock_guard lock(mutex_);
    return is_over_;
  };
  while (!is_over()) {
    try {
      auto next = graph_.wait(std::chrono::seconds(10));
      if (next) {
        if (*next && !is_over() && take(std::move(**next))) changed_();
        continue;
      }
    } catch (const std::bad_alloc&) {
      // The next change brings the whole state again.
    }
    std::unique_lock lock(mutex_);
    came_.wait_for(lock, pause, [this] { return is_over_; });
  }
}

}  // namespace agnocast::rmw
