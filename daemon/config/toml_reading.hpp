// SPDX-License-Identifier: Apache-2.0
//
// TomlReading: what the readers of all sections of agnocastd.toml share: the mistakes that they
// find, and the names of users and groups. Only config.cpp and the readers of rules use it.
#pragma once

#include <config/mistakes.hpp>
#include <daemon/config/access.hpp>
#include <daemon/config/config.hpp>

#include <toml++/toml.h>

#include <string>

namespace agnocast::daemon {

using Place = toml::source_position;

class TomlReading : public config::Mistakes {
 public:
  /// `names` must outlive it.
  TomlReading(const std::string& file, const NameLookup& names) : Mistakes(file), names_(names) {}

  /// Returns the users and groups of a list; those with a mistake are left out.
  Principals principals(const toml::node& node, const std::string& key);

  const NameLookup& names() const noexcept { return names_; }

 private:
  bool read_principal(const Place& place, const std::string& key, const std::string& text,
                      Principals& who);

  const NameLookup& names_;
};

}  // namespace agnocast::daemon
