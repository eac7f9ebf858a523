// SPDX-License-Identifier: Apache-2.0
//
// A configuration file: its text, and the text as TOML. The program that owns the keys interprets
// them.
#pragma once

#include <config/mistake.hpp>

#include <toml++/toml.h>
#include <tl/expected.hpp>

#include <cstddef>
#include <string>
#include <string_view>

namespace agnocast::config {

/// A longer file is not a configuration.
inline constexpr std::size_t file_bytes_max = std::size_t{1} << 20;

/// Returns the text of a file, or the errno: EFBIG if it is too long.
[[nodiscard]] tl::expected<std::string, int> read_file(const std::string& path);

/// Returns a table; for invalid TOML one mistake in toml++'s words, with `remedy`. `file` only
/// names the file in it.
[[nodiscard]] tl::expected<toml::table, Mistake> parse_toml(std::string_view text,
                                                            const std::string& file,
                                                            std::string remedy);

}  // namespace agnocast::config
