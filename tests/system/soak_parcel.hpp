// SPDX-License-Identifier: Apache-2.0
//
// Parcel: the message of the soak. A pure function of (token, number), where a token is given to
// one publisher only. Every byte that it ever owned is overwritten with 0xDD before it is freed:
// the old buffers of its growing sequences, and at the end the object itself. So a late read of a
// message finds something else.
#pragma once

#include <tests/system/random.hpp>

#include <agnocast/message_traits.hpp>
#include <agnocast/residency.hpp>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <new>
#include <string>
#include <vector>

namespace agnocast::test {

/// A memset that stays although nothing reads it any more.
inline void poison(void* memory, std::size_t bytes) noexcept {
  std::memset(memory, 0xDD, bytes);
  asm volatile("" : : "r"(memory) : "memory");
}

template <class T>
struct PoisoningAllocator {
  using value_type = T;
  PoisoningAllocator() noexcept = default;
  template <class U>
  PoisoningAllocator(const PoisoningAllocator<U>&) noexcept {}
  T* allocate(std::size_t count) { return static_cast<T*>(::operator new(count * sizeof(T))); }
  void deallocate(T* memory, std::size_t count) noexcept {
    poison(memory, count * sizeof(T));
    ::operator delete(memory);
  }
  friend bool operator==(PoisoningAllocator, PoisoningAllocator) noexcept { return true; }
};

struct Parcel {
  using Text = std::basic_string<char, std::char_traits<char>, PoisoningAllocator<char>>;
  /// The number of parcels in this process, published ones included.
  static inline std::atomic<std::uint64_t> alive{0};

  std::uint64_t token = 0;
  std::uint64_t number = 0;
  std::vector<std::uint64_t, PoisoningAllocator<std::uint64_t>> words;
  std::vector<Text, PoisoningAllocator<Text>> names;
  std::uint64_t seal = 0;

  Parcel() noexcept { ++alive; }
  Parcel(const Parcel& other)
      : token(other.token),
        number(other.number),
        words(other.words),
        names(other.names),
        seal(other.seal) {
    ++alive;
  }
  Parcel& operator=(const Parcel&) = delete;
  ~Parcel() { --alive; }
  static void* operator new(std::size_t bytes) { return ::operator new(bytes); }
  static void operator delete(void* memory, std::size_t bytes) noexcept {
    poison(memory, bytes);
    ::operator delete(memory);
  }
};

}  // namespace agnocast::test

template <>
struct agnocast::MessageTraits<agnocast::test::Parcel> {
  static constexpr const char* name = "tests/Parcel";
  static void for_each_pointer(const agnocast::test::Parcel& parcel,
                               PointerVisitor& visit) noexcept {
    visit("words", parcel.words);
    visit("names", parcel.names);
    for (const auto& text : parcel.names) visit("name", text);
  }
};

namespace agnocast::test {

/// The content of a parcel, determined by token and number.
class ParcelPlan {
 public:
  /// The low bits of a token: the size of its messages.
  enum class Size : std::uint64_t { small, middle, large };
  static constexpr std::uint64_t size_bits = 2;

  ParcelPlan(std::uint64_t token, std::uint64_t number) noexcept : token_(token), number_(number) {
    Random random(token * 0xd6e8feb86659fd93 ^ number * 0xa0761d6478bd642f);
    pattern_ = random.next();
    const auto size = static_cast<Size>(token & ((1 << size_bits) - 1));
    word_count_ = size == Size::large    ? 1'000 + random.below(number % 16 == 0 ? 60'000 : 5'000)
                  : size == Size::middle ? random.below(2'000)
                                         : random.below(100);
    name_count_ = random.below(4);
  }

  void fill(Parcel& parcel) const {
    parcel.token = token_;
    parcel.number = number_;
    if (pattern_ % 2 == 0) parcel.words.reserve(word_count_);
    for (std::uint64_t i = 0; i < word_count_; ++i) parcel.words.push_back(word(i));
    for (std::uint64_t i = 0; i < name_count_; ++i)
      parcel.names.emplace_back(name_length(i), name_letter(i));
    parcel.seal = seal();
  }

  /// The first member with a wrong value.
  struct Difference {
    const char* member = nullptr;  // null: none
    std::uint64_t position = 0, expected = 0, found = 0;
  };
  Difference compare(const Parcel& parcel) const noexcept {
    if (parcel.token != token_) return {"token", 0, token_, parcel.token};
    if (parcel.number != number_) return {"number", 0, number_, parcel.number};
    if (parcel.seal != seal()) return {"seal", 0, seal(), parcel.seal};
    // A freed parcel must not be walked: its pointers lead nowhere.
    if (parcel.words.size() != word_count_)
      return {"words.size()", 0, word_count_, parcel.words.size()};
    if (parcel.names.size() != name_count_)
      return {"names.size()", 0, name_count_, parcel.names.size()};
    const std::uint64_t* const words = parcel.words.data();
    for (std::uint64_t i = 0; i < word_count_; ++i) {
      if (words[i] != word(i)) return {"words", i, word(i), words[i]};
    }
    for (std::uint64_t i = 0; i < name_count_; ++i) {
      const Parcel::Text& name = parcel.names[i];
      if (name.size() != name_length(i)) return {"name.size()", i, name_length(i), name.size()};
      for (const char letter : name) {
        if (letter != name_letter(i))
          return {"name", i, static_cast<unsigned char>(name_letter(i)),
                  static_cast<unsigned char>(letter)};
      }
    }
    return {};
  }
  std::uint64_t bytes() const noexcept {
    std::uint64_t sum = sizeof(Parcel) + word_count_ * 8 + name_count_ * sizeof(Parcel::Text);
    for (std::uint64_t i = 0; i < name_count_; ++i) sum += name_length(i);
    return sum;
  }

 private:
  std::uint64_t word(std::uint64_t i) const noexcept { return pattern_ + i * 0x9e3779b97f4a7c15; }
  std::size_t name_length(std::uint64_t i) const noexcept { return (pattern_ >> i * 7) % 90; }
  char name_letter(std::uint64_t i) const noexcept {
    return static_cast<char>('a' + (pattern_ + i) % 26);
  }
  std::uint64_t seal() const noexcept { return ~pattern_; }

  std::uint64_t token_, number_, pattern_ = 0, word_count_ = 0, name_count_ = 0;
};

}  // namespace agnocast::test
