// SPDX-License-Identifier: Apache-2.0
//
// Mistakes: all that is wrong with one file of configuration. A reader goes on after the first one, so people see all of
// them at once.
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
  /// In the order of the file; toml++ has the keys of a table in the order of the alphabet.
  std::vector<Mistake> take();

 private:
  const std::string file_;
  std::vector<Mistake> list_;
};

}  // namespace agnocast::config
