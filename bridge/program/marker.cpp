// SPDX-License-Identifier: Apache-2.0

#include <bridge/program/marker.hpp>

#include <bridge/dds/names.hpp>
#include <bridge/plan/routes.hpp>

#include <utility>

namespace agnocast::bridge {
namespace {

// The topic of the markers of all bridges.
constexpr const char* marker_topic = "/_agnocast_bridge";

std::string node_name_of(const Guid& participant) {
  std::string name = std::string(bridge_node) + '_';
  for (const std::uint8_t byte : participant.bytes) {
    for (const int digit : {byte >> 4, byte & 15}) name += "0123456789abcdef"[digit];
  }
  return name;
}

}  // namespace

Marker::Marker(std::uint32_t domain, const Guid& participant, HostWatch& watch, const Log& log)
    : domain_(domain), watch_(watch), log_(log), node_name_(node_name_of(participant)) {}

bool Marker::show_oneself() {
  if (is_there()) return true;
  try {
    if (lane_ == nullptr) lane_ = std::make_unique<Lane>(node_name_);
  } catch (const Error& error) {
    refusal_ = {error.failure().code, error.what()};
    return false;
  }
  SubscriptionOptions options;
  options.connection_callback([&watch = watch_](ConnectionInfo& info) {
    watch.daemon_is(info.state != ConnectionState::reconnecting, "the connection has ended");
    if (info.state == ConnectionState::orphaned && info.reason == Errc::revoked) watch.revoke();
  });
  auto made = try_create_generic_subscription(
      lane_->node, marker_topic, TypeIdentity{"agnocast_bridge", 1}, QoS(1), nullptr, options);
  if (!made) {
    refusal_ = {made.error().code, text_of(made.error())};
    return false;
  }
  subscription_ = std::move(*made);
  refusal_.reset();
  return true;
}

void Marker::note_refusal(Refusals& refusals) const {
  if (refusal_) refusals.note("marker for other bridges", refusal_->why);
}

Marker::Role Marker::find_role(const GraphSnapshot& local) {
  if (local.incarnation == 0) return Role::unknown;  // a later snapshot will show it
  // If agnocastd's configuration forbids the marker, bridges cannot stand by for each other. Any
  // other refusal is temporary.
  if (!show_oneself()) return refusal_->code == Errc::access_denied ? Role::active : Role::unknown;
  const EndpointInfo* own = nullptr;
  const EndpointInfo* oldest = nullptr;
  for (const EndpointInfo& endpoint : local.endpoints) {
    if (endpoint.domain != domain_ || endpoint.topic != marker_topic || !is_bridge(endpoint))
      continue;
    if (endpoint.node_name == node_name_) own = &endpoint;
    if (oldest == nullptr || endpoint.generation < oldest->generation) oldest = &endpoint;
  }
  if (own == nullptr) return Role::unknown;
  const auto was_for = std::exchange(standby_for_, std::nullopt);
  if (oldest != own) {
    standby_for_ = oldest->pid;
    if (!was_for)
      log_.write(LogLevel::notice, "standby: another bridge serves this domain",
                 {{"pid", std::to_string(oldest->pid)}});
    return Role::standby;
  }
  if (was_for)
    log_.write(LogLevel::notice, "active: the other bridge of this domain has ended",
               {{"pid", std::to_string(*was_for)}});
  return Role::active;
}

}  // namespace agnocast::bridge
