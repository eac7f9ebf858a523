// SPDX-License-Identifier: Apache-2.0

#include <ros2/rmw_agnocast_cpp/core/graph_watch.hpp>

#include <agnocast/heap.hpp>
#include <base/signals.hpp>

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <new>
#include <tuple>
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

std::shared_ptr<const GraphSnapshot> GraphWatch::now() {
  // In a forked child the thread may have had the mutex.
  if (::getpid() != process_) return std::make_shared<const GraphSnapshot>();
  const LoanPause pause;  // what it keeps is private memory
  std::unique_lock lock(mutex_);
  came_.wait_until(lock, began_ + std::chrono::seconds(1),
                   [this] { return incarnation_ != 0 || is_over_; });
  look();
  if (last_ == nullptr) {
    auto snapshot = std::make_shared<GraphSnapshot>();
    snapshot->incarnation = incarnation_;
    snapshot->endpoints.reserve(endpoints_.size());
    for (const auto& [generation, endpoint] : endpoints_) snapshot->endpoints.push_back(endpoint);
    const auto place = [](const EndpointInfo& endpoint) {
      return std::tie(endpoint.topic, endpoint.kind, endpoint.generation);
    };
    std::sort(snapshot->endpoints.begin(), snapshot->endpoints.end(),
              [&](const EndpointInfo& a, const EndpointInfo& b) { return place(a) < place(b); });
    last_ = std::move(snapshot);
  }
  return last_;
}

void GraphWatch::look() {
  auto changes = graph_.look();
  if (!changes) return;
  try {
    take(std::move(*changes));
  } catch (const std::bad_alloc&) {
    // What is half done is no state to compare the next one with.
    last_.reset();
    is_unreported_ = true;
    graph_.start_over();
    throw;
  }
}

void GraphWatch::take(GraphChanges changes) {
  std::erase_if(changes.added,
                [this](const EndpointInfo& endpoint) { return endpoint.domain != domain_; });
  bool has_changed = incarnation_ != changes.incarnation;
  if (changes.is_reset) {
    decltype(endpoints_) before;
    before.swap(endpoints_);
    has_changed = has_changed || before.size() != changes.added.size();
    for (const EndpointInfo& endpoint : changes.added)
      has_changed = has_changed || !before.contains(endpoint.generation);
  }
  for (const std::uint64_t generation : changes.removed)
    has_changed |= endpoints_.erase(generation) != 0;
  has_changed |= !changes.is_reset && !changes.added.empty();
  for (EndpointInfo& endpoint : changes.added) {
    const std::uint64_t generation = endpoint.generation;
    endpoints_.insert_or_assign(generation, std::move(endpoint));
  }
  incarnation_ = changes.incarnation;
  if (!has_changed) return;
  last_.reset();
  is_unreported_ = true;
  came_.notify_all();
}

void GraphWatch::run() noexcept {
  // After an error: how long until it connects again.
  constexpr auto pause = std::chrono::seconds(1);
  for (;;) {
    bool has_failed = true;
    std::unique_lock lock(mutex_, std::defer_lock);
    try {
      has_failed = !graph_.wait_for_change(std::chrono::seconds(10));
      lock.lock();
      look();
    } catch (const std::bad_alloc&) {
      has_failed = true;
    }
    if (!lock.owns_lock()) lock.lock();
    if (is_over_) return;
    if (std::exchange(is_unreported_, false)) {
      lock.unlock();
      changed_();
    } else if (has_failed) {
      came_.wait_for(lock, pause, [this] { return is_over_; });
    }
  }
}

}  // namespace agnocast::rmw
