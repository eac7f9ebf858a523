// SPDX-License-Identifier: Apache-2.0
//
// TomlReading: what the readers of all sections of agnocastd.toml share: the mistakes that they
// find, and the names of users and groups. Only config.cpp and the readers of rules use it.
#pragma once

#include <config/mistakes.hpp>
#include <daemon/config/access.hpp>
#include <daemon/config/config.hpp>

#include <toml++/toml.h>

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::daemon {

using Place = toml::source_position;

class TomlReading {
 public:
  /// `names` must outlive it.
  TomlReading(const std::string& file, const NameLookup& names) : mistakes_(file), names_(names) {}

  void report(const Place& place, std::string key, std::string what, std::string remedy) {
    mistakes_.report(place, std::move(key), std::move(what), std::move(remedy));
  }
  /// `expected` completes "write ".
  void wrong_type(const toml::node& node, const std::string& key, std::string_view expected);
  /// `full` is the key with its section, for people.
  void unknown(const toml::key& key, const std::string& full,
               std::span<const std::string_view> known);

  /// Returns the tables of [[section]]. Anything else there is a mistake, and left out.
  std::vector<const toml::table*> tables(const toml::node& node, const std::string& section);
  /// Returns the users and groups of a list; those with a mistake are left out.
  Principals principals(const toml::node& node, const std::string& key);

  const NameLookup& names() const noexcept { return names_; }
  std::size_t mistake_count() const noexcept { return mistakes_.count(); }
  /// Returns all mistakes in the order of the file.
  std::vector<ConfigError> take_mistakes() { return mistakes_.take(); }

 private:
  bool read_principal(const Place& place, const std::string& key, const std::string& text,
                      Principals& who);

  config::Mistakes mistakes_;
  const NameLookup& names_;
};

}  // namespace agnocast::daemon
