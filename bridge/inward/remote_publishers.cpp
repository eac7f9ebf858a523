// SPDX-License-Identifier: Apache-2.0

#include <bridge/inward/remote_publishers.hpp>

#include <bridge/common/retry_interval.hpp>

#include <algorithm>
#include <string>
#include <utility>

namespace agnocast::bridge {
namespace {

// Bound for messages of one writer that keep-all blocks, besides its publisher's own queue. More
// are dropped: a DDS reader that is not read would block all topics.
constexpr std::size_t held_up_max = 1'000;

}  // namespace

Result<OpenRemotePublisher*> RemotePublishers::open(const Guid& writer,
                                                    const RemotePublisherPlan& plan) {
  auto made = make_publisher(plan, plan.depth);
  if (!made) return tl::unexpected(made.error());
  OpenRemotePublisher& open = open_[writer];
  open.plan = plan;
  open.publisher = std::move(*made);
  open.depth = plan.depth;
  return &open;
}

Result<GenericPublisher::SharedPtr> RemotePublishers::make_publisher(
    const RemotePublisherPlan& plan, std::size_t depth) const {
  return try_create_generic_publisher(node_, plan.key.topic, types_.at(plan.key.type)->introspected,
                                      qos_of(plan.qos_class, depth, plan.keep_all, plan.times));
}

void RemotePublishers::publish(const Guid& writer, OpenRemotePublisher& remote_publisher,
                               Received& received) {
  if (remote_publisher.waiting.empty() && publish_now(remote_publisher, received)) return;
  const std::size_t bytes = held_bytes_of(received.bytes);
  if (remote_publisher.waiting.size() >= held_up_max || held_bytes_ + bytes > held_bytes_max)
    return drop(remote_publisher, sentence_of(Errc::would_block));
  if (held_.empty()) next_room_look_ = {};
  held_.insert(writer);
  remote_publisher.waiting.push_back(std::move(received));
  held_bytes_ += bytes;
}

bool RemotePublishers::publish_now(OpenRemotePublisher& remote_publisher, Received& received) {
  if (!fit_history(remote_publisher, received.bytes)) {
    drop(remote_publisher, "the histories of writers in DDS have reached their limit");
    return true;
  }
  const PublishResult result = remote_publisher.publisher->publish(std::move(received.message));
  if (result.code == Errc::would_block) return false;
  if (result) {
    remote_publisher.traffic.count(received.bytes);
    if (remote_publisher.plan.qos_class.transient_local) {
      remote_publisher.history.push_back(received.bytes);
      remote_publisher.history_bytes += received.bytes;
      history_bytes_ += received.bytes;
    }
  } else {
    drop(remote_publisher, sentence_of(result.code));
  }
  return true;
}

void RemotePublishers::forget_history(OpenRemotePublisher& remote_publisher) {
  history_bytes_ -= remote_publisher.history_bytes;
  remote_publisher.history_bytes = 0;
  remote_publisher.history.clear();
}

// A writer in DDS announces the depth of its history and fills it: beyond a limit its publisher
// here is replaced by one with fewer slots. Subscriptions get the messages of both; later
// subscriptions find a shorter history.
bool RemotePublishers::fit_history(OpenRemotePublisher& remote_publisher, std::size_t bytes) {
  if (!remote_publisher.plan.qos_class.transient_local) return true;
  const auto pop = [&] {
    history_bytes_ -= remote_publisher.history.front();
    remote_publisher.history_bytes -= remote_publisher.history.front();
    remote_publisher.history.pop_front();
  };
  while (remote_publisher.history.size() >= remote_publisher.depth) pop();
  const bool is_own =
      remote_publisher.history_bytes + bytes > most_of(Limit::history_bytes_of_remote_publisher);
  const bool is_all = history_bytes_ + bytes > most_of(Limit::history_bytes);
  if (!remote_publisher.history.empty() && (is_own || is_all)) {
    limits_.refuse(is_own ? Limit::history_bytes_of_remote_publisher : Limit::history_bytes);
    const std::size_t depth =
        is_all ? 1 : std::max<std::size_t>(remote_publisher.history.size() / 2, 1);
    auto made = make_publisher(remote_publisher.plan, depth);
    if (!made) return false;
    deleter_.end(std::exchange(remote_publisher.publisher, std::move(*made)));
    remote_publisher.depth = depth;
    forget_history(remote_publisher);
  }
  if (history_bytes_ + bytes > most_of(Limit::history_bytes) && history_bytes_ != 0) {
    limits_.refuse(Limit::history_bytes);
    return false;
  }
  return true;
}

void RemotePublishers::drop(OpenRemotePublisher& remote_publisher, const char* why,
                            std::size_t messages) const {
  const std::uint64_t dropped = remote_publisher.traffic.refused += messages;
  if (!remote_publisher.traffic.reports.now()) return;
  log_.write(LogLevel::warning, "message not published",
             {{"topic", remote_publisher.plan.key.topic},
              {"dropped", std::to_string(dropped)},
              {"why", why}});
}

std::optional<Time> RemotePublishers::publish_waiting(Time now) {
  if (!held_.empty() && next_room_look_ <= now) {
    retry_interval_ = retry_interval_after(retry_interval_, publish_held());
    next_room_look_ = now + retry_interval_;
  }
  return held_.empty() ? std::nullopt : std::optional(next_room_look_);
}

bool RemotePublishers::publish_held() {
  bool any = false;
  std::erase_if(held_, [&](const Guid& writer) {
    OpenRemotePublisher& remote_publisher = open_.at(writer);
    while (!remote_publisher.waiting.empty()) {
      const std::size_t bytes = held_bytes_of(remote_publisher.waiting.front().bytes);
      if (!publish_now(remote_publisher, remote_publisher.waiting.front())) return false;
      remote_publisher.waiting.pop_front();
      held_bytes_ -= bytes;
      any = true;
    }
    return true;
  });
  return any;
}

void RemotePublishers::drop_waiting(const Guid& writer, OpenRemotePublisher& remote_publisher) {
  drop(remote_publisher, sentence_of(Errc::would_block), remote_publisher.waiting.size());
  for (const Received& received : remote_publisher.waiting)
    held_bytes_ -= held_bytes_of(received.bytes);
  remote_publisher.waiting.clear();
  held_.erase(writer);
}

std::optional<Time> RemotePublishers::tidy(Time now) {
  std::optional<Time> next;
  for (auto at = open_.begin(); at != open_.end();) {
    OpenRemotePublisher& remote_publisher = at->second;
    const bool is_late = remote_publisher.end && *remote_publisher.end <= now;
    if (is_late && *remote_publisher.end + held_linger <= now && !remote_publisher.waiting.empty())
      drop_waiting(at->first, remote_publisher);
    if (is_late && remote_publisher.waiting.empty()) {
      forget_history(remote_publisher);
      deleter_.end(std::move(remote_publisher.publisher));  // may wait for an absent agnocastd
      at = open_.erase(at);
      continue;
    }
    next = earliest(next, remote_publisher.handover.next());
    if (remote_publisher.end) next = earliest(next, is_late ? now + linger : *remote_publisher.end);
    ++at;
  }
  return next;
}

void RemotePublishers::clear() {
  open_.clear();
  history_bytes_ = 0;
  held_.clear();
  held_bytes_ = 0;
}

}  // namespace agnocast::bridge
