// SPDX-License-Identifier: Apache-2.0

#include <client/endpoint/endpoint_events.hpp>

#include <base/clock.hpp>
#include <client/process/forked_child.hpp>

#include <string_view>
#include <utility>

namespace agnocast {

void EndpointEvents::gained() noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.matched;
  ++now_.alive;
  if (watch_ != nullptr) watch_->notify();
  changed();
}

void EndpointEvents::ceased(bool was_alive) noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.ceased;
  --(was_alive ? now_.alive : now_.not_alive);
  if (watch_ != nullptr) watch_->notify();
  changed();
}

void EndpointEvents::incompatible_qos(QosPolicyKind policy) noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.qos;
  last_policy_ = policy;
  changed();
}

void EndpointEvents::incompatible_type() noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.types;
  changed();
}

void EndpointEvents::connection(const ConnectionInfo& info) noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.connections;
  connection_ = info;
  changed();
  if (watch_ != nullptr) watch_->notify();
}

void EndpointEvents::heap_collision(const char* text) noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.collisions;
  char(&last)[sizeof last_collision_.last_text] = last_collision_.last_text;
  last[std::string_view(text).copy(last, sizeof last - 1)] = '\0';
  changed();
}

void EndpointEvents::quota_reached() noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.quota_reached;
  changed();
}

void EndpointEvents::publisher_exhausted() noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.publisher_exhausted;
  changed();
}

void EndpointEvents::begin_deadline(std::uint64_t period_ns) noexcept {
  deadline_.begin(period_ns, monotonic_ns());
}

void EndpointEvents::look_at_deadline(std::uint64_t newest_ns) noexcept {
  const std::lock_guard lock(mutex_);
  const std::uint64_t missed = deadline_.look(monotonic_ns(), newest_ns);
  if (missed == 0) return;  // a loop that looks must not wake itself
  now_.deadlines += missed;
  changed();
}

void EndpointEvents::liveliness_changed(bool is_alive) noexcept {
  const std::lock_guard lock(mutex_);
  ++(is_alive ? now_.alive : now_.not_alive);
  --(is_alive ? now_.not_alive : now_.alive);
  changed();
}

void EndpointEvents::liveliness_lost() noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.liveliness_lost;
  changed();
}

void EndpointEvents::moved() noexcept {
  const std::lock_guard lock(mutex_);
  if (watch_ != nullptr) watch_->notify();
}

MatchedInfo EndpointEvents::matched_since(Counts& notified) const noexcept {
  const std::uint64_t gained = now_.matched - notified.matched;
  const std::uint64_t ceased = now_.ceased - notified.ceased;
  notified.matched = now_.matched;
  notified.ceased = now_.ceased;
  return {now_.matched, gained, now_.matched - now_.ceased,
          static_cast<std::int32_t>(static_cast<std::int64_t>(gained - ceased))};
}

IncompatibleQosInfo EndpointEvents::qos_since(Counts& notified) const noexcept {
  const std::uint64_t change = now_.qos - std::exchange(notified.qos, now_.qos);
  return {static_cast<std::int32_t>(now_.qos), static_cast<std::int32_t>(change), last_policy_};
}

IncompatibleTypeInfo EndpointEvents::types_since(Counts& notified) const noexcept {
  const std::uint64_t change = now_.types - std::exchange(notified.types, now_.types);
  return {static_cast<std::int32_t>(now_.types), static_cast<std::int32_t>(change)};
}

HeapCollisionInfo EndpointEvents::collisions_since(Counts& notified) const noexcept {
  HeapCollisionInfo info = last_collision_;
  info.total_count = static_cast<std::int32_t>(now_.collisions);
  info.total_count_change = static_cast<std::int32_t>(
      now_.collisions - std::exchange(notified.collisions, now_.collisions));
  return info;
}

HoldQuotaInfo EndpointEvents::quota_reached_since(Counts& notified) const noexcept {
  const std::uint64_t change =
      now_.quota_reached - std::exchange(notified.quota_reached, now_.quota_reached);
  return {static_cast<std::int32_t>(now_.quota_reached), static_cast<std::int32_t>(change)};
}

DeadlineMissedInfo EndpointEvents::deadlines_since(Counts& notified) const noexcept {
  const std::uint64_t change = now_.deadlines - std::exchange(notified.deadlines, now_.deadlines);
  return {static_cast<std::int32_t>(now_.deadlines), static_cast<std::int32_t>(change)};
}

LivelinessLostInfo EndpointEvents::liveliness_lost_since(Counts& notified) const noexcept {
  const std::uint64_t change =
      now_.liveliness_lost - std::exchange(notified.liveliness_lost, now_.liveliness_lost);
  return {static_cast<std::int32_t>(now_.liveliness_lost), static_cast<std::int32_t>(change)};
}

LivelinessChangedInfo EndpointEvents::liveliness_since(Counts& notified) const noexcept {
  const std::int64_t alive = now_.alive - std::exchange(notified.alive, now_.alive);
  const std::int64_t not_alive = now_.not_alive - std::exchange(notified.not_alive, now_.not_alive);
  return {static_cast<std::int32_t>(now_.alive), static_cast<std::int32_t>(now_.not_alive),
          static_cast<std::int32_t>(alive), static_cast<std::int32_t>(not_alive)};
}

MatchedInfo EndpointEvents::matched_status() noexcept {
  if (is_forked_child()) return {};
  const std::lock_guard lock(mutex_);
  return matched_since(notified_by_status_);
}

IncompatibleQosInfo EndpointEvents::incompatible_qos_status() noexcept {
  if (is_forked_child()) return {};
  const std::lock_guard lock(mutex_);
  return qos_since(notified_by_status_);
}

IncompatibleTypeInfo EndpointEvents::incompatible_type_status() noexcept {
  if (is_forked_child()) return {};
  const std::lock_guard lock(mutex_);
  return types_since(notified_by_status_);
}

HeapCollisionInfo EndpointEvents::heap_collision_status() noexcept {
  if (is_forked_child()) return {};
  const std::lock_guard lock(mutex_);
  return collisions_since(notified_by_status_);
}

HoldQuotaInfo EndpointEvents::hold_quota_status() noexcept {
  if (is_forked_child()) return {};
  const std::lock_guard lock(mutex_);
  return quota_reached_since(notified_by_status_);
}

DeadlineMissedInfo EndpointEvents::deadline_missed_status() noexcept {
  if (is_forked_child()) return {};
  const std::lock_guard lock(mutex_);
  return deadlines_since(notified_by_status_);
}

LivelinessLostInfo EndpointEvents::liveliness_lost_status() noexcept {
  if (is_forked_child()) return {};
  const std::lock_guard lock(mutex_);
  return liveliness_lost_since(notified_by_status_);
}

LivelinessChangedInfo EndpointEvents::liveliness_changed_status() noexcept {
  if (is_forked_child()) return {};
  const std::lock_guard lock(mutex_);
  return liveliness_since(notified_by_status_);
}

void EndpointEvents::wake_for(const detail::EventCallbacks& callbacks,
                              std::shared_ptr<WaitSet> wait_set) noexcept {
  const std::lock_guard lock(mutex_);
  wanted_ = {callbacks.matched != nullptr,
             callbacks.incompatible_qos != nullptr,
             callbacks.incompatible_type != nullptr,
             callbacks.connection != nullptr,
             callbacks.heap_collision != nullptr,
             callbacks.hold_quota != nullptr,
             callbacks.deadline != nullptr,
             callbacks.liveliness_lost != nullptr,
             callbacks.liveliness_changed != nullptr,
             callbacks.publisher_exhausted != nullptr};
  wait_set_ = std::move(wait_set);
  changed();
}

void EndpointEvents::tell(std::shared_ptr<Watch> watch) noexcept {
  const std::lock_guard lock(mutex_);
  watch_ = std::move(watch);
}

bool EndpointEvents::look_for_pending() const noexcept {
  return (wanted_.matched && matched_changed()) ||
         (wanted_.qos && now_.qos != notified_by_callback_.qos) ||
         (wanted_.types && now_.types != notified_by_callback_.types) ||
         (wanted_.connections && now_.connections != notified_by_callback_.connections) ||
         (wanted_.collisions && now_.collisions != notified_by_callback_.collisions) ||
         (wanted_.quota_reached && now_.quota_reached != notified_by_callback_.quota_reached) ||
         (wanted_.deadlines && now_.deadlines != notified_by_callback_.deadlines) ||
         (wanted_.liveliness_lost &&
          now_.liveliness_lost != notified_by_callback_.liveliness_lost) ||
         (wanted_.liveliness_changed && liveliness_has_changed()) ||
         (wanted_.publisher_exhausted &&
          now_.publisher_exhausted != notified_by_callback_.publisher_exhausted);
}

void EndpointEvents::changed() noexcept {
  const bool pending = look_for_pending();
  pending_.store(pending, std::memory_order_release);
  const WaitSet* const polling = polling_.load(std::memory_order_acquire);
  if (wait_set_ == nullptr && polling != nullptr) polling->wake();
  if (pending && wait_set_ != nullptr) wait_set_->wake();
}

bool EndpointEvents::run_one(const detail::EventCallbacks& callbacks) {
  if (!has_pending()) return false;
  std::unique_lock lock(mutex_);
  const auto run = [&](const auto& callback, auto info) {
    pending_.store(look_for_pending(), std::memory_order_release);
    lock.unlock();
    callback(info);
    return true;
  };
  if (wanted_.matched && matched_changed())
    return run(callbacks.matched, matched_since(notified_by_callback_));
  if (wanted_.qos && now_.qos != notified_by_callback_.qos)
    return run(callbacks.incompatible_qos, qos_since(notified_by_callback_));
  if (wanted_.types && now_.types != notified_by_callback_.types)
    return run(callbacks.incompatible_type, types_since(notified_by_callback_));
  if (wanted_.connections && now_.connections != notified_by_callback_.connections) {
    notified_by_callback_.connections = now_.connections;
    return run(callbacks.connection, ConnectionInfo(connection_));
  }
  if (wanted_.collisions && now_.collisions != notified_by_callback_.collisions)
    return run(callbacks.heap_collision, collisions_since(notified_by_callback_));
  if (wanted_.quota_reached && now_.quota_reached != notified_by_callback_.quota_reached)
    return run(callbacks.hold_quota, quota_reached_since(notified_by_callback_));
  if (wanted_.deadlines && now_.deadlines != notified_by_callback_.deadlines)
    return run(callbacks.deadline, deadlines_since(notified_by_callback_));
  if (wanted_.liveliness_lost && now_.liveliness_lost != notified_by_callback_.liveliness_lost)
    return run(callbacks.liveliness_lost, liveliness_lost_since(notified_by_callback_));
  if (wanted_.liveliness_changed && liveliness_has_changed())
    return run(callbacks.liveliness_changed, liveliness_since(notified_by_callback_));
  if (wanted_.publisher_exhausted &&
      now_.publisher_exhausted != notified_by_callback_.publisher_exhausted) {
    notified_by_callback_.publisher_exhausted = now_.publisher_exhausted;
    return run([&](bool) { callbacks.publisher_exhausted(); }, true);
  }
  return false;
}

}  // namespace agnocast
