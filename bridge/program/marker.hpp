// SPDX-License-Identifier: Apache-2.0
//
// Marker: two bridges of one domain at one daemon would double every message. So each has an endpoint that the others see,
// the marker, before anything else, and has routes only if no older marker is there: a snapshot with its own has all that
// are older.
//
// One thread, run()'s; the marker's connection says to HostWatch what becomes of agnocastd.
#pragma once

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <agnocast/graph.hpp>
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
  /// `participant` has a name that no other bridge has. `watch` and `log` must outlive it.
  Marker(std::uint32_t domain, const Guid& participant, HostWatch& watch, const Log& log);

  /// Active: nothing of this domain was here first.
  enum class Role : std::uint8_t { unknown, active, standby };
  /// By what there is on this host; makes the marker first, if there is none.
  Role find_role(const GraphSnapshot& local);
  /// The pid of the bridge that is active in our place, as find_role() found last.
  std::optional<std::uint32_t> standby_for() const noexcept { return standby_for_; }

  bool is_there() const noexcept { return subscription_ != nullptr; }
  /// Notes why there is none, if it could not be made.
  void note_refusal(Refusals& refusals) const;
  /// Whether agnocastd, which is there, did not make it.
  bool is_refused() const noexcept {
    return refusal_ && refusal_->code != Errc::daemon_not_running;
  }

 private:
  /// What all bridges of this domain can see of this one; false if it is not there yet.
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
  std::unique_ptr<Node> node_;
  GenericSubscription::SharedPtr subscription_;
};

}  // namespace agnocast::bridge
