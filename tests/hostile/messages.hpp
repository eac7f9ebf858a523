// SPDX-License-Identifier: Apache-2.0
//
// Messages that the honest processes of these tests send and receive.
//
//   Numbered   the stream: its content is a function of its number, behind a pointer
//   Flat       the attackers' type: it has no pointers, so a reader can look at garbage
#pragma once

#include <agnocast/agnocast.hpp>

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace agnocast::test {

struct Numbered : SharedMessage {
  std::uint64_t number = 0;
  SharedVector<std::uint64_t> data;
};

struct Flat : SharedMessage {
  std::uint64_t word[8] = {};
};
static_assert(sizeof(Flat) == 64, "flat_bytes of hostile_node.hpp");

/// Large, and distinguished by its number.
struct Bulk : SharedMessage {
  static constexpr std::size_t bytes = std::size_t{1} << 20;
  std::uint64_t number = 0;
  SharedVector<std::byte> data;
};

constexpr std::size_t length_of(std::uint64_t number) noexcept { return 1 + number * 37 % 500; }
constexpr std::uint64_t element_of(std::uint64_t number, std::size_t i) noexcept {
  return (number + 1) * 0x9e3779b97f4a7c15 ^ i;
}
inline void fill(Numbered& message, std::uint64_t number) {
  message.number = number;
  for (std::size_t i = 0; i < length_of(number); ++i) message.data.push_back(element_of(number, i));
}
inline bool is_intact(const Numbered& message, std::uint64_t number) noexcept {
  if (message.number != number || message.data.size() != length_of(number)) return false;
  for (std::size_t i = 0; i < message.data.size(); ++i) {
    if (message.data[i] != element_of(number, i)) return false;
  }
  return true;
}

}  // namespace agnocast::test

template <>
struct agnocast::MessageTraits<agnocast::test::Numbered> {
  static constexpr const char* name = "tests/Numbered";
  static void for_each_pointer(const agnocast::test::Numbered& message,
                               PointerVisitor& visit) noexcept {
    visit("data", message.data);
  }
};
template <>
struct agnocast::MessageTraits<agnocast::test::Bulk> {
  static constexpr const char* name = "tests/Bulk";
  static void for_each_pointer(const agnocast::test::Bulk& message,
                               PointerVisitor& visit) noexcept {
    visit("data", message.data);
  }
};
template <>
struct agnocast::MessageTraits<agnocast::test::Flat> {
  static constexpr const char* name = "tests/Flat";
};
