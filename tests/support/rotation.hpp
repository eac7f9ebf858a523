// SPDX-License-Identifier: Apache-2.0
//
// Rotation: the part of a long list that this run covers. AGNOCAST_ROTATION="1/3" is every third
// item, starting with the second; without the variable it is all. scripts/test sets it by the
// number of commits, so that the parts alternate; with --full it does not.
#pragma once

#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <string>

namespace agnocast::test {

class Rotation {
 public:
  Rotation() {
    const char* const text = std::getenv("AGNOCAST_ROTATION");
    if (text == nullptr) return;
    if (std::sscanf(text, "%zu/%zu", &part_, &parts_) == 2 && part_ < parts_) return;
    std::fprintf(stderr, "AGNOCAST_ROTATION is %s, not PART/PARTS with PART from 0\n", text);
    std::exit(2);
  }
  std::size_t part() const noexcept { return part_; }
  std::size_t parts() const noexcept { return parts_; }
  /// Returns whether this run covers item `index` of `count`. It covers one at least: a list that
  /// is shorter than the rotation has as many parts as items.
  bool takes(std::size_t index, std::size_t count) const noexcept {
    const std::size_t parts = count < parts_ ? count : parts_;
    return index % parts == part_ % parts;
  }
  std::string text() const {
    if (parts_ == 1) return "all";
    return "part " + std::to_string(part_ + 1) + " of " + std::to_string(parts_) +
           " (all: scripts/test --full)";
  }

 private:
  std::size_t part_ = 0, parts_ = 1;
};

}  // namespace agnocast::test
