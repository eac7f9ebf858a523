// SPDX-License-Identifier: Apache-2.0

#include <config/mistakes.hpp>

#include <algorithm>

namespace agnocast::config {

void Mistakes::report(const toml::source_position& place, std::string key, std::string what,
                      std::string remedy) {
  list_.push_back({file_, static_cast<std::uint32_t>(place.line),
                   static_cast<std::uint32_t>(place.column), std::move(key), std::move(what),
                   std::move(remedy)});
}

std::vector<Mistake> Mistakes::take() {
  std::stable_sort(list_.begin(), list_.end(), [](const Mistake& a, const Mistake& b) {
    return std::pair(a.line, a.column) < std::pair(b.line, b.column);
  });
  return std::exchange(list_, {});
}

}  // namespace agnocast::config
