// SPDX-License-Identifier: Apache-2.0
//
// A file of configuration: its text, and the text as TOML. What its keys mean is the matter of the program that has them.
#pragma once

#include <config/mistake.hpp>

#include <toml++/toml.h>
#include <tl/expected.hpp>

#include <cstddef>
#include <string>
#include <string_view>

namespace agnocast::config {

/// Anything longer is not ours.
inline constexpr std::size_t file_bytes_max = std::size_t{1} << 20;

/// The text of a file, or the errno: EFBIG if it is too long.
[[nodiscard]] tl::expected<std::string, int> read_file(const std::string& path);

/// What is no TOML is one mistake, in toml++'s words; `remedy` says what to do about it. `file` is only named there.
[[nodiscard]] tl::expected<toml::table, Mistake> parse_toml(std::string_view text,
                                                            const std::string& file,
                                                            std::string remedy);

}  // namespace agnocast::config
