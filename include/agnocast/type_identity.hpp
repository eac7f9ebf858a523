// SPDX-License-Identifier: Apache-2.0
//
// Type identity: decides whether two processes have the same C++ type, byte for byte.
//
// A type is (name, layout hash). Publisher and subscription must agree in both, or they are not
// matched. The layout hash covers the type's own description (members, offsets, sizes) and
// everything that changes layouts silently: the standard library, its ABI switches, its debug
// mode, the machine. This header computes the second half, because only the user's own
// translation unit knows it; client/api/message_type.cpp computes the first.
#pragma once

#include <cfloat>
#include <climits>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#if defined(__GLIBCXX__) && (!defined(_GLIBCXX_USE_CXX11_ABI) || !_GLIBCXX_USE_CXX11_ABI)
#error \
    "agnocast: the old string ABI (_GLIBCXX_USE_CXX11_ABI=0) shares string buffers by a counter beside the text, \
which subscribers could not write; compile with _GLIBCXX_USE_CXX11_ABI=1"
#endif

namespace agnocast {

/// The pair that is compared at match. `name` belongs to the MessageType it came from.
struct TypeIdentity {
  std::string_view name;
  std::uint64_t layout_hash = 0;

  friend bool operator==(const TypeIdentity& a, const TypeIdentity& b) noexcept {
    return a.layout_hash == b.layout_hash && a.name == b.name;
  }
  friend bool operator!=(const TypeIdentity& a, const TypeIdentity& b) noexcept {
    return !(a == b);
  }
};

/// FNV-1a, 64 bits, over an unambiguous encoding: integers as eight bytes, texts after their
/// length.
///
/// Why 64 bits are enough: the hash is compared only between types of the same name, so only the
/// few versions of one message on a machine must not collide. A thousand versions collide with a
/// chance of 2^-45 (n²/2 pairs over 2^64). It is no defence against forgery, which gains nothing:
/// a process that may publish may write any bytes anyway.
class LayoutHash {
 public:
  constexpr LayoutHash& add(std::uint64_t number) noexcept {
    for (int shift = 0; shift < 64; shift += 8)
      add_byte(static_cast<unsigned char>(number >> shift));
    return *this;
  }
  constexpr LayoutHash& add(std::string_view text) noexcept {
    add(static_cast<std::uint64_t>(text.size()));
    for (char letter : text) add_byte(static_cast<unsigned char>(letter));
    return *this;
  }
  constexpr void add_byte(unsigned char byte) noexcept {
    value_ = (value_ ^ byte) * 1099511628211U;
  }
  constexpr std::uint64_t value() const noexcept { return value_; }

 private:
  std::uint64_t value_ = 14695981039346656037U;
};

namespace detail {

constexpr std::uint64_t hash_of_build() noexcept {
  LayoutHash hash;
  hash.add(
      std::string_view("agnocast layout 1"));  // the encoding itself: change it with the encoding
#if defined(_LIBCPP_VERSION)
  hash.add(std::string_view("libc++")).add(std::uint64_t{_LIBCPP_ABI_VERSION});
#elif defined(__GLIBCXX__)
  hash.add(std::string_view("libstdc++")).add(std::uint64_t{_GLIBCXX_USE_CXX11_ABI});
#else
  hash.add(std::string_view("another standard library"));
#endif
#if defined(_GLIBCXX_DEBUG)
  hash.add(std::string_view("_GLIBCXX_DEBUG"));
#endif
#if defined(_GLIBCXX_INLINE_VERSION) && _GLIBCXX_INLINE_VERSION
  hash.add(std::string_view("_GLIBCXX_INLINE_VERSION"));
#endif
  hash.add(sizeof(std::string)).add(alignof(std::string));
  hash.add(sizeof(std::u16string)).add(alignof(std::u16string));
  hash.add(sizeof(std::vector<char>)).add(alignof(std::vector<char>));
  hash.add(sizeof(std::vector<bool>)).add(alignof(std::vector<bool>));
  hash.add(sizeof(void*)).add(sizeof(long)).add(sizeof(bool));
  // x86 has three kinds of long double, chosen by -mlong-double-64 and the like.
  hash.add(sizeof(long double)).add(alignof(long double)).add(std::uint64_t{LDBL_MANT_DIG});
  hash.add(alignof(double)).add(alignof(std::uint64_t)).add(alignof(std::max_align_t));
  hash.add(std::uint64_t{CHAR_MIN < 0});
  hash.add(std::uint64_t{__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__});
  return hash.value();
}

// Internal linkage on purpose: each translation unit has the value of its own compiler switches.
constexpr std::uint64_t build_hash = hash_of_build();

}  // namespace detail
}  // namespace agnocast
