// SPDX-License-Identifier: Apache-2.0
//
// Rules: which topics are bridged, which way and with which QoS, as the [[topic]] tables of the configuration say it.
// Pure.
//
// The first rule that matches decides; when none does, the default direction. So a bridge for chosen topics alone has
// `default = "none"`.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace agnocast::bridge {

/// As a bit set: both is outward and inward.
enum class Direction : std::uint8_t {
  none = 0,
  outward = 1,  ///< from agnocast to DDS
  inward = 2,   ///< from DDS to agnocast
  both = 3,
};
constexpr bool goes(Direction allowed, Direction way) noexcept {
  return (static_cast<unsigned>(allowed) & static_cast<unsigned>(way)) != 0;
}

/// What a rule says of an endpoint in DDS; what it does not say follows who is there.
struct QosOverride {
  std::optional<bool> reliable, transient_local;
  std::optional<std::size_t> depth;  // of keep-last

  bool operator==(const QosOverride&) const = default;
};

struct Rule {
  std::string topic;  // pattern, agnocast/topic_pattern.hpp
  Direction direction = Direction::both;
  std::uint32_t line = 0;     // of the file, for people
  std::string type = {};      // only of this one, as ROS has it; empty: of any
  QosOverride to_dds = {};    // what writers there offer
  QosOverride from_dds = {};  // what readers there request
  bool always = false;        // also while nobody is on the other side; the pattern is a name then
};

/// What the rules say of a topic, and which of them: null when none speaks of it.
struct Verdict {
  Direction direction = Direction::both;
  const Rule* rule = nullptr;
};
Verdict verdict_of(std::span<const Rule> rules, std::string_view topic, std::string_view type,
                   Direction otherwise) noexcept;

}  // namespace agnocast::bridge
