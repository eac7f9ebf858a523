// SPDX-License-Identifier: Apache-2.0
//
// Reads configurations from text, with accounts of the test's own.
#pragma once

#include <daemon/config/config.hpp>

#include <optional>
#include <string>
#include <string_view>

namespace agnocast::daemon {

inline const NameLookup names{
    [](const std::string& name) -> std::optional<uid_t> {
      return name == "alice" || name == "lidar" ? std::optional<uid_t>(1000) : std::nullopt;
    },
    [](const std::string& name) -> std::optional<gid_t> {
      return name == "sensors" ? std::optional<gid_t>(50) : std::nullopt;
    }};

inline ConfigResult parse(std::string_view text) { return parse_config(text, "f.toml", names); }

/// Returns all errors, one per line.
inline std::string errors_of(std::string_view text) {
  const auto config = parse(text);
  if (config) return "no error";
  std::string all;
  for (const ConfigError& error : config.error()) all += (all.empty() ? "" : "\n") + error.text();
  return all;
}

}  // namespace agnocast::daemon
