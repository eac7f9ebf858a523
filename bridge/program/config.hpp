// SPDX-License-Identifier: Apache-2.0
//
// Config: bridge.toml. An error names file, line and column, the mistake, and the correct form.
//
//   domain = 0                       # of ROS; default: ROS_DOMAIN_ID
//   default = "none"                 # for topics that no rule matches
//
//   [[topic]]                        # the first match decides
//   name = "/lidar/**"
//   direction = "out"                # "both", "out" (agnocast to DDS), "in", "none"
//   to_dds = { reliability = "best_effort", depth = 1 }
//
// config_keys() lists all keys.
#pragma once

#include <base/domain.hpp>
#include <base/text/log.hpp>
#include <bridge/program/bridge.hpp>
#include <config/mistake.hpp>

#include <tl/expected.hpp>

#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::bridge {

using ConfigError = config::Mistake;
/// One key, for the manual page and the example.
struct ConfigKey {
  std::string_view name;
  std::string_view value;  ///< the valid values
  std::string_view meaning;
};
std::span<const ConfigKey> config_keys() noexcept;

/// `domain` stays empty if the file does not set it.
struct Config {
  std::optional<std::uint32_t> domain;
  std::optional<agnocast::LogLevel> log_level;
  BridgeOptions bridge;
};
/// Reads a file. Returns all mistakes, in the order of the file.
[[nodiscard]] tl::expected<Config, std::vector<ConfigError>> load_config(const std::string& path);
/// Does the same with a text; `name` stands for the file in errors.
[[nodiscard]] tl::expected<Config, std::vector<ConfigError>> parse_config(const std::string& text,
                                                                          const std::string& name);

}  // namespace agnocast::bridge
