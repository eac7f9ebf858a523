// SPDX-License-Identifier: Apache-2.0
//
// The plan: a message type reduced to the parts that the residency check must visit.
//
// Made once per endpoint by message_type.cpp, walked at every publish by residency.cpp. Members
// without memory of their own do not appear; plain nested messages are flattened into their
// parent; the rest is one step per string, sequence, or fixed array of elements that own memory.
// Steps of a subtree are neighbours, so a walk is a loop over a small array:
//
//     PointCloud2:   [0] string "name"             steps of one PointField
//                    [1] string "header.frame_id"
//                    [2] sequence "fields" of {0}
//                    [3] sequence "data" of nothing      root = {1, 3}
//
// The plan holds no function of the user's type support, so that library may be unloaded while
// messages live.
#pragma once

#include <agnocast/message_type.hpp>

#include <cstddef>
#include <cstdint>
#include <deque>
#include <string>
#include <type_traits>
#include <vector>

namespace agnocast::detail {

// Depth of nested messages. ROS's own nest about 4 deep; 32 levels of the walk are a few KiB of
// stack.
inline constexpr std::size_t plan_depth_max = 32;
// Members of a message with all its nested ones, arrays counted once; Autoware's largest has some
// hundreds. The bound is necessary because a type that nests two of a type that nests two …
// doubles at each level.
inline constexpr std::size_t plan_member_count_max = 65536;

enum class Step : std::uint8_t {
  string,     // std::string
  u16string,  // std::u16string
  bits,       // std::vector<bool>
  sequence,   // any other std::vector, or BoundedVector, which is one; its elements may have
              // steps
  array,      // std::array of `count` elements that have steps
};

struct StepRange {
  std::uint32_t first = 0;
  std::uint32_t count = 0;
};

struct PlanStep {
  Step step;
  std::uint32_t offset;  // bytes from the start of the enclosing element or message
  std::uint32_t count;   // elements of an array
  std::uint32_t stride;  // sizeof an element of a sequence or array
  StepRange elements;    // steps of one element
  const char* path;      // "header.frame_id"; empty for a string that is itself an element
};

struct MessagePlan {
  std::string name;
  std::uint64_t layout_hash = 0;
  std::uint32_t bytes = 0;
  std::uint32_t alignment = 0;
  MessageType::Kind kind = MessageType::Kind::opaque;
  void (*visit)(const void* message, PointerVisitor& visitor) = nullptr;
  bool bits_are_seen = false;  // the reader of vector<bool> passed its self-test
  std::vector<PlanStep> steps;
  StepRange root;
  std::deque<std::string> paths;  // a deque: its elements do not move
};

// Layout of a std::vector of anything but bool in libstdc++ and libc++. Verified: see probe() in
// message_type.cpp.
struct VectorWords {
  const std::byte* begin;
  const std::byte* end;
  const std::byte* end_of_storage;
};
static_assert(sizeof(VectorWords) == sizeof(std::vector<int>) &&
              alignof(VectorWords) == alignof(std::vector<int>));

// Finds the bits of a vector<bool>. libstdc++ has a public member for them in its iterator, used
// here without naming private layout; other libraries have none. `words` returns null if the
// place is unknown.
template <class Bits, class = void>
struct BitsReader {
  static const void* words(const Bits&) noexcept { return nullptr; }
  static std::size_t bytes(const Bits& bits) noexcept { return (bits.size() + 7) / 8; }
};
template <class Bits>
struct BitsReader<Bits, std::void_t<decltype(*std::declval<const Bits&>().begin()._M_p)>> {
  static const void* words(const Bits& bits) noexcept { return bits.begin()._M_p; }
  // In whole words, as readers load them.
  static std::size_t bytes(const Bits& bits) noexcept {
    constexpr std::size_t word_bytes = sizeof(*bits.begin()._M_p);
    return (bits.size() + word_bytes * 8 - 1) / (word_bytes * 8) * word_bytes;
  }
};

// Returns whether the reader really finds the bits: writes patterns through the vector's own
// interface and compares memory. Allocates, may throw bad_alloc; called when a type is described,
// never by the check.
template <class Bits>
bool bits_reader_holds() {
  for (const std::size_t size : {1U, 63U, 64U, 65U, 1000U}) {
    Bits bits(size, false);
    for (std::size_t i = 0; i < size; ++i) bits[i] = i % 3 == 0 || i % 7 == 0;
    const void* words = BitsReader<Bits>::words(bits);
    if (words == nullptr || BitsReader<Bits>::bytes(bits) * 8 < size) return false;
    const auto* memory = static_cast<const unsigned long*>(words);
    constexpr std::size_t word_bits = sizeof(unsigned long) * 8;
    for (std::size_t i = 0; i < size; ++i) {
      if (((memory[i / word_bits] >> (i % word_bits)) & 1) != static_cast<unsigned long>(bits[i]))
        return false;
    }
  }
  return true;
}

}  // namespace agnocast::detail
