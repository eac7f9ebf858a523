// SPDX-License-Identifier: Apache-2.0
//
// Sheaf: a small unsized message without rosidl, for endurance tests and instruction counts.
#pragma once

#include <agnocast/message_traits.hpp>
#include <agnocast/residency.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace agnocast::test {

struct Sheaf {
  std::uint64_t number = 0;
  std::vector<std::uint64_t> words;
  std::vector<std::string> names;
};

}  // namespace agnocast::test

template <>
struct agnocast::MessageTraits<agnocast::test::Sheaf> {
  static constexpr const char* name = "tests/Sheaf";
  static void for_each_pointer(const agnocast::test::Sheaf& sheaf, PointerVisitor& visit) noexcept {
    visit("words", sheaf.words);
    visit("names", sheaf.names);
  }
};

namespace agnocast::test {

/// Sizes repeat the same few hundred values, so a heap that leaks nothing stops growing.
inline void fill(Sheaf& sheaf, std::uint64_t number) {
  sheaf.number = number;
  const std::uint64_t size = number * 7919 % 257;
  for (std::uint64_t i = 0; i < size; ++i) sheaf.words.push_back(number + i);
  for (std::uint64_t i = 0; i < number % 3; ++i)
    sheaf.names.emplace_back(20 + (number + i) % 50, static_cast<char>('a' + number % 26));
}
inline bool is_intact(const Sheaf& sheaf, std::uint64_t number) {
  Sheaf expected;
  fill(expected, number);
  return sheaf.number == number && sheaf.words == expected.words && sheaf.names == expected.names;
}

}  // namespace agnocast::test
