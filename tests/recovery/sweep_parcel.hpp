// SPDX-License-Identifier: Apache-2.0
//
// Parcel: the message of the process sweeps. Unsized, a function of (publisher, number), poisoned
// in its destructor, so that late reads are noticed.
#pragma once

#include <agnocast/agnocast.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace agnocast::sweep {

struct Parcel {
  std::uint64_t publisher = 0;
  std::uint64_t number = 0;
  std::vector<std::uint64_t> words;
  std::string text;

  Parcel() = default;
  Parcel(const Parcel&) = default;
  Parcel& operator=(const Parcel&) = delete;
  ~Parcel() {
    volatile std::uint64_t* const at = words.data();
    for (std::size_t i = 0; i < words.size(); ++i) at[i] = 0xdeaddeaddeaddead;
    const_cast<volatile std::uint64_t&>(number) = 0xdeaddeaddeaddead;
  }

  static std::uint64_t word(std::uint64_t publisher, std::uint64_t number, std::uint64_t i) {
    return (publisher << 32 ^ number) * 0x9e3779b97f4a7c15 + i;
  }
  static std::string text_of(std::uint64_t publisher, std::uint64_t number) {
    return "a text that does not fit into the string " + std::to_string(publisher) + ":" +
           std::to_string(number);
  }

  void fill(std::uint64_t of, std::uint64_t as, std::uint64_t count) {
    publisher = of;
    number = as;
    for (std::uint64_t i = 0; i < count; ++i) words.push_back(word(of, as, i));
    text = text_of(of, as);
  }
  bool intact() const {
    for (std::uint64_t i = 0; i < words.size(); ++i) {
      if (words[i] != word(publisher, number, i)) return false;
    }
    return !words.empty() && text == text_of(publisher, number);
  }
  std::string name() const { return std::to_string(publisher) + ":" + std::to_string(number); }
};

}  // namespace agnocast::sweep

template <>
struct agnocast::MessageTraits<agnocast::sweep::Parcel> {
  static constexpr const char* name = "tests/Parcel";
  static void for_each_pointer(const sweep::Parcel& parcel, PointerVisitor& visit) noexcept {
    visit("words", parcel.words);
    visit("text", parcel.text);
  }
};
