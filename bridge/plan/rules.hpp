// SPDX-License-Identifier: Apache-2.0
//
// Rules: which topics are bridged, in which direction and with which QoS, from the [[topic]]
// tables of the configuration. Pure.
//
// The first rule that matches decides, else the default direction. A bridge for selected topics
// only has `default = "none"`.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace agnocast::bridge {

/// A bit set: both is outward and inward.
enum class Direction : std::uint8_t {
  none = 0,
  outward = 1,  ///< from agnocast to DDS
  inward = 2,   ///< from DDS to agnocast
  both = 3,
};
constexpr bool goes(Direction allowed, Direction way) noexcept {
  return (static_cast<unsigned>(allowed) & static_cast<unsigned>(way)) != 0;
}

/// The QoS that a rule sets for an endpoint in DDS; the rest follows the other side.
struct QosOverride {
  std::optional<bool> reliable, transient_local;
  std::optional<std::size_t> depth;  // for keep-last

  bool operator==(const QosOverride&) const = default;
};

struct Rule {
  std::string topic;  // pattern, agnocast/topic_pattern.hpp
  Direction direction = Direction::both;
  std::uint32_t line = 0;     // line in the file, for people
  std::string type = {};      // only this type, in ROS form; empty: any
  QosOverride to_dds = {};    // offered by DDS writers
  QosOverride from_dds = {};  // requested by DDS readers
  bool always = false;        // even without an endpoint there; needs a full name
};

/// The direction for a topic, and the rule that sets it; null: no rule matches.
struct Verdict {
  Direction direction = Direction::both;
  const Rule* rule = nullptr;
};
Verdict verdict_of(std::span<const Rule> rules, std::string_view topic, std::string_view type,
                   Direction otherwise) noexcept;

}  // namespace agnocast::bridge
