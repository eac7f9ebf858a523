// SPDX-License-Identifier: Apache-2.0
//
// Specimen: the message of the deep comparisons. A message is a pure function of (seed, publisher,
// number, bytes), so a reader makes the expected one in its own memory and compares the two member
// by member, down to the last string of the innermost sequence. Everything.msg has every kind of
// member that a ROS message can have; sequences are filled as nodes fill them: push_back, resize,
// assign, reserve, swap. Sizes are random, empty ones included.
#pragma once

#include <tests/system/random.hpp>

#include <agnocast_test_msgs/msg/everything.hpp>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace agnocast::test {

using Specimen = agnocast_test_msgs::msg::Everything;

/// The identity that a message carries.
struct SpecimenName {
  std::uint64_t publisher = 0;
  std::uint64_t number = 0;
  std::uint64_t bytes = 0;  // of its large blob
  bool operator==(const SpecimenName&) const = default;
};

class SpecimenMaker {
 public:
  /// Fills the new `message` with the content that seed and name determine.
  static void fill(Specimen& message, std::uint64_t seed, const SpecimenName& name) {
    SpecimenMaker maker(seed ^ name.publisher * 0xd6e8feb86659fd93 ^
                        name.number * 0xa0761d6478bd642f);
    maker.members(message);
    std::memcpy(message.fixed_numbers.data(), &name.publisher, 8);
    std::memcpy(message.fixed_numbers.data() + 8, &name.number, 8);
    message.numbers.push_back(static_cast<double>(name.bytes));
    maker.bytes(message.inner.blob, name.bytes);
  }
  static SpecimenName name_of(const Specimen& message) {
    SpecimenName name;
    std::memcpy(&name.publisher, message.fixed_numbers.data(), 8);
    std::memcpy(&name.number, message.fixed_numbers.data() + 8, 8);
    if (!message.numbers.empty()) name.bytes = static_cast<std::uint64_t>(message.numbers.back());
    return name;
  }
  /// Returns whether `message` equals, member by member, what its name determines.
  static bool is_intact(const Specimen& message, std::uint64_t seed, const SpecimenName& name) {
    Specimen expected;
    fill(expected, seed, name);
    return message == expected;
  }

 private:
  explicit SpecimenMaker(std::uint64_t seed) noexcept : random_(seed) {}

  /// Returns a size: often 0, mostly small, sometimes larger.
  std::size_t count(std::size_t most) {
    const std::uint64_t kind = random_.below(10);
    return static_cast<std::size_t>(kind < 3 ? 0 : random_.below((kind < 9 ? most / 4 : most) + 1));
  }
  template <class Text>
  void text(Text& text, std::size_t most) {
    const std::size_t length = count(most);
    for (std::size_t i = 0; i < length; ++i)
      text.push_back(static_cast<typename Text::value_type>('!' + random_.below(90)));
  }
  template <class Bytes>
  void bytes(Bytes& bytes, std::size_t length) {
    const std::uint64_t pattern = random_.next();
    bytes.resize(length);
    std::size_t i = 0;
    for (; i + 8 <= length; i += 8) {
      const std::uint64_t word = pattern + i * 0x9e3779b97f4a7c15;
      std::memcpy(bytes.data() + i, &word, 8);
    }
    for (; i < length; ++i) bytes[i] = static_cast<std::uint8_t>(pattern + i);
  }
  template <class Bits>
  void bits(Bits& bits, std::size_t most) {
    const std::size_t length = count(most);
    if (random_.chance(50)) bits.assign(length / 2, true);
    while (bits.size() < length) bits.push_back(random_.chance(50));
  }
  template <class Sequence, class Fill>
  void sequence(Sequence& sequence, std::size_t most, Fill fill) {
    const std::size_t length = count(most);
    if (random_.chance(30)) sequence.reserve(length);
    if (random_.chance(50)) sequence.resize(length / 2);
    for (auto& element : sequence) fill(element);
    while (sequence.size() < length) {
      sequence.emplace_back();
      fill(sequence.back());
    }
  }
  void members(agnocast_test_msgs::msg::Flat& flat) {
    flat.x = static_cast<float>(random_.below(1000000)) / 8;
    flat.y = static_cast<double>(random_.next() >> 12);
    for (auto& letter : flat.tag) letter = static_cast<std::uint8_t>(random_.next());
  }
  void members(agnocast_test_msgs::msg::Inner& inner) {
    text(inner.label, 60);
    sequence(inner.notes, 12, [&](auto& note) { text(note, 80); });
    bytes(inner.blob, count(3000));
    text(inner.wide, 30);
    bits(inner.flags, 300);
  }
  void members(Specimen& m) {
    const auto inner = [&](auto& element) { members(element); };
    const auto note = [&](auto& element) { text(element, 40); };
    bits(m.flags, 500);
    bits(m.bounded_flags, 200);
    for (auto& flag : m.fixed_flags) flag = random_.chance(50);
    text(m.text, 200);
    text(m.bounded_text, 40);
    for (auto& element : m.fixed_texts) text(element, 40);
    sequence(m.texts, 20, [&](auto& element) { text(element, 100); });
    sequence(m.bounded_texts, 4, note);
    sequence(m.texts_of_bounded, 8, note);
    text(m.wide, 50);
    for (auto& element : m.fixed_wides) text(element, 20);
    sequence(m.wides, 6, note);
    sequence(m.numbers, 400,
             [&](double& number) { number = static_cast<double>(random_.below(1u << 30)) / 3; });
    sequence(m.bounded_numbers, 5,
             [&](auto& number) { number = static_cast<std::int32_t>(random_.next()); });
    members(m.inner);
    for (auto& element : m.fixed_inners) members(element);
    sequence(m.inners, 12, inner);
    sequence(m.bounded_inners, 3, inner);
    sequence(m.nothings, 5, [](auto&) {});
    sequence(m.flats, 40, inner);
    for (auto& element : m.fixed_flats) members(element);
  }

  Random random_;
};

}  // namespace agnocast::test
