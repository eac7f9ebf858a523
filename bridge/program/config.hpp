// SPDX-License-Identifier: Apache-2.0
//
// Config: bridge.toml. A mistake is reported with file, line, column, what is wrong and what to write.
//
//   domain = 0                       # of ROS; ROS_DOMAIN_ID if it is not written
//   default = "none"                 # of topics that no rule speaks of
//
//   [[topic]]                        # the first that matches decides
//   name = "/lidar/**"
//   direction = "out"                # "both", "out" (agnocast to DDS), "in", "none"
//   to_dds = { reliability = "best_effort", depth = 1 }
//
// config_keys() has all of them.
#pragma once

#include <base/log.hpp>
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
/// For the manual page and the example.
struct ConfigKey {
  std::string_view name;
  std::string_view value;  ///< what may be written
  std::string_view meaning;
};
std::span<const ConfigKey> config_keys() noexcept;

/// `domain` stays empty when the file does not say it.
struct Config {
  std::optional<std::uint32_t> domain;
  std::optional<agnocast::LogLevel> log_level;
  BridgeOptions bridge;
};
/// Reads a file. All mistakes at once, in the order of the file.
[[nodiscard]] tl::expected<Config, std::vector<ConfigError>> load_config(const std::string& path);
/// The same of a text; `name` stands for the file in errors.
[[nodiscard]] tl::expected<Config, std::vector<ConfigError>> parse_config(const std::string& text,
                                                                          const std::string& name);

}  // namespace agnocast::bridge
