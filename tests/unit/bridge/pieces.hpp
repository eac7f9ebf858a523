// SPDX-License-Identifier: Apache-2.0
//
// Payloads in pieces, each in its own allocation, so that a sanitizer sees reads past its end.
#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <vector>

namespace agnocast::test {

class Pieces {
 public:
  /// Makes one piece.
  explicit Pieces(std::span<const std::byte> bytes) : Pieces(bytes, std::vector{bytes.size()}) {}
  /// Makes pieces of these lengths, then one of the rest.
  Pieces(std::span<const std::byte> bytes, const std::vector<std::size_t>& lengths) {
    for (const std::size_t length : lengths) {
      add(bytes.first(std::min(length, bytes.size())));
      bytes = bytes.subspan(std::min(length, bytes.size()));
    }
    if (!bytes.empty()) add(bytes);
  }
  /// Makes pieces of one byte, each followed by an empty one.
  static Pieces of_single_bytes(std::span<const std::byte> bytes) {
    std::vector<std::size_t> lengths;
    for (std::size_t i = 0; i < bytes.size(); ++i) lengths.insert(lengths.end(), {1, 0});
    return Pieces(bytes, lengths);
  }

  std::span<const std::span<const std::byte>> all() const { return spans_; }

 private:
  void add(std::span<const std::byte> bytes) {
    memory_.emplace_back(bytes.begin(), bytes.end());
    memory_.back().shrink_to_fit();
    spans_.emplace_back(memory_.back());
  }

  std::vector<std::vector<std::byte>> memory_;
  std::vector<std::span<const std::byte>> spans_;
};

}  // namespace agnocast::test
