// SPDX-License-Identifier: Apache-2.0
//
// Config keys: the one table of everything the configuration can say. Used by the reader and the
// printer of config.hpp, and by nobody else.
#pragma once

#include <daemon/config.hpp>

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::daemon::config_keys {

enum class Kind : std::uint8_t { count, bytes, mode, level, path, group };

struct Key {
  std::string_view section;
  std::string_view name;
  Kind kind;
  // Of numbers: bounds, what they must be a multiple of, and a word with the number it stands for.
  std::uint64_t least;
  std::uint64_t most;
  std::uint64_t unit;
  std::string_view word;
  std::uint64_t word_value;
  std::uint64_t (*number)(const Config&);
  void (*set_number)(Config&, std::uint64_t);
  // Of texts: "auto" is the empty one.
  std::string& (*text)(Config&);
  std::string_view meaning;

  std::string full() const { return std::string(section) + '.' + std::string(name); }
};

/// In the order in which they are printed, each section in one piece.
std::span<const Key> all() noexcept;
/// The names of a section.
std::vector<std::string_view> names_in(std::string_view section);

}  // namespace agnocast::daemon::config_keys
