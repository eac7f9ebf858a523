// SPDX-License-Identifier: Apache-2.0
//
// Config keys: the one table of all keys of the configuration. Only the reader and the printer of
// config.hpp, and the manual page, use it.
#pragma once

#include <daemon/config/config.hpp>

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::daemon::config_keys {

enum class Kind : std::uint8_t { count, bytes, mode, level, path, group, topics };

struct Key {
  std::string_view section;
  std::string_view name;
  Kind kind;
  // For numbers: bounds, the unit of which they must be a multiple, and words with their numbers.
  std::uint64_t least;
  std::uint64_t most;
  std::uint64_t unit;
  std::string_view word;
  std::uint64_t word_value;
  std::uint64_t (*number)(const Config&);
  void (*set_number)(Config&, std::uint64_t);
  // For texts: "auto" is the empty one.
  std::string& (*text)(Config&);
  std::vector<std::string>& (*topics)(Config&);
  std::string_view meaning;
  std::string_view other_word = {};
  std::uint64_t other_value = 0;

  std::optional<std::uint64_t> number_of_word(std::string_view written) const noexcept {
    if (written.empty()) return std::nullopt;
    if (written == word) return word_value;
    if (written == other_word) return other_value;
    return std::nullopt;
  }
  /// Returns the words of a number as alternatives: ", or "auto"".
  std::string or_words() const {
    std::string words;
    for (const std::string_view one : {word, other_word}) {
      if (!one.empty()) words += ", or \"" + std::string(one) + '"';
    }
    return words;
  }
  std::string full() const { return std::string(section) + '.' + std::string(name); }
};

/// Returns the keys in the order of printing, each section in one piece.
std::span<const Key> all() noexcept;
/// Returns the names in a section.
std::vector<std::string_view> names_in(std::string_view section);

}  // namespace agnocast::daemon::config_keys
