// SPDX-License-Identifier: Apache-2.0

#include <base/text/text.hpp>

#include <algorithm>
#include <numeric>
#include <vector>

namespace agnocast {
namespace {

// Levenshtein distance with transpositions of neighbours: typical typing errors.
std::size_t distance(std::string_view left, std::string_view right) {
  const std::size_t columns = right.size() + 1;
  std::vector<std::size_t> before(columns), above(columns), row(columns);
  std::iota(above.begin(), above.end(), std::size_t{0});
  for (std::size_t i = 1; i <= left.size(); ++i) {
    row[0] = i;
    for (std::size_t j = 1; j <= right.size(); ++j) {
      const bool same = left[i - 1] == right[j - 1];
      row[j] = std::min({above[j] + 1, row[j - 1] + 1, above[j - 1] + (same ? 0 : 1)});
      if (i > 1 && j > 1 && left[i - 1] == right[j - 2] && left[i - 2] == right[j - 1])
        row[j] = std::min(row[j], before[j - 2] + 1);
    }
    before.swap(above);
    above.swap(row);
  }
  return above.back();
}

}  // namespace

std::string escaped(std::string_view text, std::size_t length_max) {
  constexpr char digits[] = "0123456789abcdef";
  std::string result;
  for (const char c : text.substr(0, length_max)) {
    const auto value = static_cast<unsigned char>(c);
    if (c == '\n') {
      result += "\\n";
    } else if (c == '\t') {
      result += "\\t";
    } else if (c == '\\' || c == '"') {
      result += '\\';
      result += c;
    } else if (value < 0x20 || value > 0x7e) {
      result += "\\x";
      result += digits[value >> 4];
      result += digits[value & 15];
    } else {
      result += c;
    }
  }
  if (text.size() > length_max) result += "...";
  return result;
}

std::string in_quotes(std::string_view text, std::size_t length_max) {
  return '"' + escaped(text, length_max) + '"';
}

std::string_view nearest(std::string_view wanted, std::span<const std::string_view> words) {
  if (wanted.size() > 64) return {};  // no typing error, and the work is quadratic
  std::string_view best;
  std::size_t best_distance = 0;
  for (const std::string_view word : words) {
    const std::size_t found = distance(wanted, word);
    if (found * 3 > word.size()) continue;
    if (best.empty() || found < best_distance) {
      best = word;
      best_distance = found;
    }
  }
  return best;
}

}  // namespace agnocast
