// SPDX-License-Identifier: Apache-2.0

#include <config/mistake.hpp>

#include <base/text/text.hpp>

namespace agnocast::config {

std::string Mistake::where() const {
  std::string text = escaped(file);
  if (line != 0) text += ':' + std::to_string(line) + ':' + std::to_string(column);
  if (!key.empty()) text += ": " + key;
  return text;
}

std::string Mistake::text() const { return where() + ": " + what + "; " + remedy; }

}  // namespace agnocast::config
