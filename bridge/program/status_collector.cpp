// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/status_collector.hpp>

#include <agnocast/connection_state.hpp>

#include <utility>

namespace agnocast::bridge {

std::optional<BridgeStatus> StatusCollector::ask(std::chrono::milliseconds patience) {
  std::unique_lock lock(mutex_);
  answer_.reset();
  is_asked_ = true;
  parts_.participant.interrupt();
  answered_.wait_for(lock, patience, [this] { return answer_.has_value(); });
  is_asked_ = false;
  return std::exchange(answer_, std::nullopt);
}

void StatusCollector::answer() {
  {
    const std::lock_guard lock(mutex_);
    if (!is_asked_) return;
  }
  BridgeStatus now = look();
  const std::lock_guard lock(mutex_);
  answer_ = std::move(now);
  answered_.notify_all();
}

BridgeStatus StatusCollector::look() const {
  BridgeStatus now;
  now.domain = domain_;
  now.layout = parts_.ros_graph.layout();
  const ConnectionState connection = connection_state();
  now.has_daemon = parts_.watch.has_daemon() && connection != ConnectionState::reconnecting &&
                   connection != ConnectionState::orphaned;
  now.standby_for = parts_.marker.standby_for();
  for (const LimitRow& row : limit_table)
    now.limits.push_back({row.name, row.most, parts_.participant.limits().refused(row.limit)});
  now.discovery_info_refused = parts_.ros_graph.refused();
  now.since_ns = since_ns_;
  for (const auto& [guid, remote] : parts_.participant.remotes())
    now.participants += remote.kind == Remote::Kind::participant;
  parts_.outward.look(now);
  parts_.inward.look(now, parts_.ros_graph.others());
  now.services = parts_.services.look();
  now.unbridged = parts_.planner.unbridged();
  now.failures.assign(parts_.refusals.now().begin(), parts_.refusals.now().end());
  return now;
}

}  // namespace agnocast::bridge
