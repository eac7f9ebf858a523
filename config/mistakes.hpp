// SPDX-License-Identifier: Apache-2.0
//
// Mistakes: all errors in one configuration file. A reader continues after the first one, so users
// see all of them at once.
#pragma once

#include <config/mistake.hpp>

#include <toml++/toml.h>

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::config {

/// The mistakes in one file, as its reader finds them.
class Mistakes {
 public:
  explicit Mistakes(std::string file) : file_(std::move(file)) {}

  void report(const toml::source_position& place, std::string key, std::string what,
              std::string remedy);
  std::size_t count() const noexcept { return list_.size(); }
  /// Returns them in the order of the file; toml++ iterates a table's keys in alphabetical order.
  std::vector<Mistake> take();

 private:
  const std::string file_;
  std::vector<Mistake> list_;
};

}  // namespace agnocast::config
