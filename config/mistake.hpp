// SPDX-License-Identifier: Apache-2.0
//
// Mistake: one error in a configuration file, with its place and the correct form.
#pragma once

#include <cstdint>
#include <string>

namespace agnocast::config {

struct Mistake {
  std::string file;
  std::uint32_t line = 0;    // from 1; 0: the file as a whole
  std::uint32_t column = 0;  // from 1
  std::string key;           // "limits.depth_max"; empty if the mistake is in no key
  std::string what;
  std::string remedy;

  /// Returns "agnocastd.toml:12:5: limits.depth_max".
  std::string where() const;
  /// Returns "agnocastd.toml:12:5: limits.depth_max: 5000 is out of range; use 1 to 1000".
  std::string text() const;
};

}  // namespace agnocast::config
