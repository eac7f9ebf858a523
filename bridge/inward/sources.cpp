// SPDX-License-Identifier: Apache-2.0

#include <bridge/inward/sources.hpp>

#include <bridge/common/room.hpp>

#include <algorithm>
#include <string>
#include <utility>

namespace agnocast::bridge {
namespace {

// Bound for messages of one writer that keep-all blocks, besides its publisher's own queue. More
// are dropped: a DDS reader that is not read would block all topics.
constexpr std::size_t held_up_max = 1'000;

}  // namespace

Result<OpenSource*> Sources::open(const Guid& writer, const Source& plan) {
  auto made = make_publisher(plan, plan.depth);
  if (!made) return tl::unexpected(made.error());
  OpenSource& open = open_[writer];
  open.plan = plan;
  open.publisher = std::move(*made);
  open.depth = plan.depth;
  return &open;
}

Result<GenericPublisher::SharedPtr> Sources::make_publisher(const Source& plan,
                                                            std::size_t depth) const {
  return try_create_generic_publisher(node_, plan.key.topic, types_.at(plan.key.type)->introspected,
                                      qos_of(plan.qos_class, depth, plan.keep_all));
}

void Sources::publish(const Guid& writer, OpenSource& source, Received& received) {
  if (source.waiting.empty() && publish_now(source, received)) return;
  const std::size_t bytes = held_bytes_of(received.bytes);
  if (source.waiting.size() >= held_up_max || held_bytes_ + bytes > held_bytes_max)
    return drop(source, sentence_of(Errc::would_block));
  if (held_.empty()) next_room_look_ = {};
  held_.insert(writer);
  source.waiting.push_back(std::move(received));
  held_bytes_ += bytes;
}

bool Sources::publish_now(OpenSource& source, Received& received) {
  if (!fit_history(source, received.bytes)) {
    drop(source, "the histories of writers in DDS have reached their limit");
    return true;
  }
  const PublishResult result = source.publisher->publish(std::move(received.message));
  if (result.code == Errc::would_block) return false;
  if (result) {
    source.traffic.count(received.bytes);
    if (source.plan.qos_class.transient_local) {
      source.history.push_back(received.bytes);
      source.history_bytes += received.bytes;
      history_bytes_ += received.bytes;
    }
  } else {
    drop(source, sentence_of(result.code));
  }
  return true;
}

void Sources::forget_history(OpenSource& source) {
  history_bytes_ -= source.history_bytes;
  source.history_bytes = 0;
  source.history.clear();
}

// A writer in DDS announces the depth of its history and fills it: beyond a limit its publisher
// here is replaced by one with fewer slots. Subscriptions get the messages of both; later
// subscriptions find a shorter history.
bool Sources::fit_history(OpenSource& source, std::size_t bytes) {
  if (!source.plan.qos_class.transient_local) return true;
  const auto pop = [&] {
    history_bytes_ -= source.history.front();
    source.history_bytes -= source.history.front();
    source.history.pop_front();
  };
  while (source.history.size() >= source.depth) pop();
  const bool is_own = source.history_bytes + bytes > most_of(Limit::history_bytes_of_source);
  const bool is_all = history_bytes_ + bytes > most_of(Limit::history_bytes);
  if (!source.history.empty() && (is_own || is_all)) {
    limits_.refuse(is_own ? Limit::history_bytes_of_source : Limit::history_bytes);
    const std::size_t depth = is_all ? 1 : std::max<std::size_t>(source.history.size() / 2, 1);
    auto made = make_publisher(source.plan, depth);
    if (!made) return false;
    reaper_.end(std::exchange(source.publisher, std::move(*made)));
    source.depth = depth;
    forget_history(source);
  }
  if (history_bytes_ + bytes > most_of(Limit::history_bytes) && history_bytes_ != 0) {
    limits_.refuse(Limit::history_bytes);
    return false;
  }
  return true;
}

void Sources::drop(OpenSource& source, const char* why, std::size_t messages) const {
  const std::uint64_t dropped = source.traffic.refused += messages;
  if (!source.traffic.tells.now()) return;
  log_.write(
      LogLevel::warning, "message not published",
      {{"topic", source.plan.key.topic}, {"dropped", std::to_string(dropped)}, {"why", why}});
}

std::optional<Time> Sources::publish_waiting(Time now) {
  if (!held_.empty() && next_room_look_ <= now) {
    room_interval_ = room_interval_after(room_interval_, publish_held());
    next_room_look_ = now + room_interval_;
  }
  return held_.empty() ? std::nullopt : std::optional(next_room_look_);
}

bool Sources::publish_held() {
  bool any = false;
  std::erase_if(held_, [&](const Guid& writer) {
    OpenSource& source = open_.at(writer);
    while (!source.waiting.empty()) {
      const std::size_t bytes = held_bytes_of(source.waiting.front().bytes);
      if (!publish_now(source, source.waiting.front())) return false;
      source.waiting.pop_front();
      held_bytes_ -= bytes;
      any = true;
    }
    return true;
  });
  return any;
}

void Sources::drop_waiting(const Guid& writer, OpenSource& source) {
  drop(source, sentence_of(Errc::would_block), source.waiting.size());
  for (const Received& received : source.waiting) held_bytes_ -= held_bytes_of(received.bytes);
  source.waiting.clear();
  held_.erase(writer);
}

std::optional<Time> Sources::tidy(Time now) {
  std::optional<Time> next;
  for (auto at = open_.begin(); at != open_.end();) {
    OpenSource& source = at->second;
    const bool is_late = source.end && *source.end <= now;
    if (is_late && *source.end + held_linger <= now && !source.waiting.empty())
      drop_waiting(at->first, source);
    if (is_late && source.waiting.empty()) {
      forget_history(source);
      reaper_.end(std::move(source.publisher));  // may wait for an absent agnocastd
      at = open_.erase(at);
      continue;
    }
    // A message that both DDS readers received may still be taken from the other one.
    next = earliest(next, source.way.tidy(now));
    if (source.end) next = earliest(next, is_late ? now + linger : *source.end);
    ++at;
  }
  return next;
}

void Sources::clear() {
  open_.clear();
  history_bytes_ = 0;
  held_.clear();
  held_bytes_ = 0;
}

}  // namespace agnocast::bridge
