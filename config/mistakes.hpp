// SPDX-License-Identifier: Apache-2.0
//
// Mistakes: all errors in one configuration file. A reader continues after the first one, so users
// see all of them at once.
#pragma once

#include <config/mistake.hpp>

#include <toml++/toml.h>

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::config {

/// The mistakes in one file, as its reader finds them.
class Mistakes {
 public:
  explicit Mistakes(std::string file) : file_(std::move(file)) {}

  void report(const toml::source_position& place, std::string key, std::string what,
              std::string remedy);
  /// `expected` completes "write ".
  void wrong_type(const toml::node& node, const std::string& key, std::string_view expected);
  /// `full` is the key with its section, for people.
  void unknown(const toml::key& key, const std::string& full,
               std::span<const std::string_view> known);
  /// Returns the tables of [[section]]. Anything else there is a mistake, and left out.
  std::vector<const toml::table*> tables(const toml::node& node, const std::string& section);
  std::size_t count() const noexcept { return list_.size(); }
  /// Returns them in the order of the file; toml++ iterates a table's keys in alphabetical order.
  std::vector<Mistake> take();

 private:
  const std::string file_;
  std::vector<Mistake> list_;
};

}  // namespace agnocast::config
