// SPDX-License-Identifier: Apache-2.0

#include <client/endpoint/endpoint_events.hpp>
#include <client/process/forked_child.hpp>

#include <string_view>
#include <utility>

namespace agnocast {

void EndpointEvents::gained() noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.matched;
  if (watch_ != nullptr) watch_->notify();
  changed();
}

void EndpointEvents::ceased() noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.ceased;
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

void EndpointEvents::drained() noexcept {
  const std::lock_guard lock(mutex_);
  ++now_.drained;
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

void EndpointEvents::wake_for(const detail::EventCallbacks& callbacks,
                              std::shared_ptr<WaitSet> wait_set) noexcept {
  const std::lock_guard lock(mutex_);
  wanted_ = {callbacks.matched != nullptr,
             callbacks.incompatible_qos != nullptr,
             callbacks.incompatible_type != nullptr,
             callbacks.connection != nullptr,
             callbacks.heap_collision != nullptr,
             callbacks.hold_quota != nullptr,
             callbacks.drained != nullptr};
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
         (wanted_.drained && now_.drained != notified_by_callback_.drained);
}

void EndpointEvents::changed() noexcept {
  const bool pending = look_for_pending();
  pending_.store(pending, std::memory_order_release);
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
  if (wanted_.drained && now_.drained != notified_by_callback_.drained) {
    notified_by_callback_.drained = now_.drained;
    return run([&](bool) { callbacks.drained(); }, true);
  }
  return false;
}

}  // namespace agnocast
