// SPDX-License-Identifier: Apache-2.0
//
// Marker: two bridges of one domain at one daemon would double every message. So each bridge first
// creates an endpoint that the others see, the marker, and has routes only if there is no older
// marker: a snapshot with its own marker contains all older ones.
//
// One thread, run()'s; the marker's connection reports changes of agnocastd to HostWatch.
#pragma once

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <agnocast/graph.hpp>
#include <bridge/common/lane.hpp>
#include <bridge/common/log.hpp>
#include <bridge/common/refusals.hpp>
#include <bridge/dds/participant.hpp>
#include <bridge/program/host_watch.hpp>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

namespace agnocast::bridge {

class Marker {
 public:
  /// `participant` gives a name that no other bridge has. `watch` and `log` must outlive it.
  Marker(std::uint32_t domain, const Guid& participant, HostWatch& watch, const Log& log);

  /// Active: no other bridge of this domain was here first.
  enum class Role : std::uint8_t { unknown, active, standby };
  /// Returns the role by the endpoints of this host; creates the marker first if there is none.
  Role find_role(const GraphSnapshot& local);
  /// Returns the pid of the bridge that serves the domain instead, as of the last find_role().
  std::optional<std::uint32_t> standby_for() const noexcept { return standby_for_; }

  bool is_there() const noexcept { return subscription_ != nullptr; }
  /// Notes why there is no marker, if it could not be created.
  void note_refusal(Refusals& refusals) const;
  /// Returns whether agnocastd refused the marker.
  bool is_refused() const noexcept {
    return refusal_ && refusal_->code != Errc::daemon_not_running;
  }

 private:
  /// Creates the marker; returns false if it does not exist yet.
  bool show_oneself();

  struct Refusal {
    Errc code;
    std::string why;
  };

  const std::uint32_t domain_;
  HostWatch& watch_;
  const Log& log_;
  const std::string node_name_;
  std::optional<Refusal> refusal_;
  std::optional<std::uint32_t> standby_for_;
  std::unique_ptr<Lane> lane_;
  GenericSubscription::SharedPtr subscription_;
};

}  // namespace agnocast::bridge
