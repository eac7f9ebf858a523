// SPDX-License-Identifier: Apache-2.0
//
// Messages of any type with random values, and their comparison, both by the introspection table.
// Both would miss the same member, so tests of typed messages also compare with the types' own
// operator==.
#pragma once

#include <agnocast/generic.hpp>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::test {

namespace ros = rosidl_typesupport_introspection_cpp;

inline bool is_fixed_array(const MessageMember& member) {
  return member.is_array_ && member.array_size_ != 0 && !member.is_upper_bound_;
}
inline bool is_bit_vector(const MessageMember& member) {
  return member.is_array_ && !is_fixed_array(member) && member.type_id_ == ros::ROS_TYPE_BOOLEAN;
}
inline std::size_t element_count(const MessageMember& member, const void* at) {
  if (!member.is_array_) return 1;
  return is_fixed_array(member) ? member.array_size_ : member.size_function(at);
}
inline const std::byte* element_at(const MessageMember& member, const void* at, std::size_t i) {
  return static_cast<const std::byte*>(member.is_array_ ? member.get_const_function(at, i) : at);
}
inline std::byte* element_at(const MessageMember& member, void* at, std::size_t i) {
  return static_cast<std::byte*>(member.is_array_ ? member.get_function(at, i) : at);
}

class RandomMessages {
 public:
  struct Options {
    bool has_nan = true;
    /// Any byte in strings, any word in wide ones; otherwise letters.
    bool has_any_text = true;
  };
  RandomMessages(std::uint64_t seed, Options options) : random_(seed), options_(options) {}

  void fill(const MessageMembers& members, void* message, int depth = 0) {
    for (std::uint32_t i = 0; i < members.member_count_; ++i) {
      const MessageMember& member = members.members_[i];
      void* const at = static_cast<std::byte*>(message) + member.offset_;
      // A placeholder in an empty message, without meaning.
      if (std::string_view(member.name_) == "structure_needs_at_least_one_member") continue;
      if (member.is_array_ && !is_fixed_array(member))
        member.resize_function(at, length(member, depth));
      if (is_bit_vector(member)) {
        auto& bits = *static_cast<std::vector<bool>*>(at);
        for (std::size_t n = 0; n < bits.size(); ++n) bits[n] = below(2) == 1;
        continue;
      }
      for (std::size_t n = element_count(member, at); n-- > 0;)
        fill_element(member, element_at(member, at, n), depth);
    }
  }

 private:
  std::uint64_t below(std::uint64_t bound) { return random_() % bound; }
  std::size_t length(const MessageMember& member, int depth) {
    // Deep nesting multiplies the elements.
    const bool is_long = depth == 0 && member.type_id_ != ros::ROS_TYPE_MESSAGE;
    const std::size_t most = is_long ? 200 : 3;
    const std::size_t bound = member.is_upper_bound_ ? std::min(member.array_size_, most) : most;
    switch (below(4)) {
      case 0:
        return 0;
      case 1:
        return bound;
      default:
        return below(std::min<std::size_t>(bound, 4) + 1);
    }
  }
  template <class Number>
  void integer(std::byte* at) {
    Number value = static_cast<Number>(random_());
    if (below(4) == 0) value = std::numeric_limits<Number>::min();
    if (below(4) == 0) value = std::numeric_limits<Number>::max();
    std::memcpy(at, &value, sizeof value);
  }
  template <class Number>
  void floating(std::byte* at) {
    using Limits = std::numeric_limits<Number>;
    Number values[] = {0,
                       -Number{0},
                       Number(0.1),
                       Number(1e21),
                       Number(-123456),
                       Limits::max(),
                       Limits::denorm_min(),
                       Limits::infinity(),
                       -Limits::infinity(),
                       Number(static_cast<double>(random_()) / 1e9)};
    Number value = values[below(std::size(values))];
    if (options_.has_nan && below(8) == 0) value = Limits::quiet_NaN();
    std::memcpy(at, &value, sizeof value);
  }
  template <class String>
  void text(const MessageMember& member, String& target) {
    // Texts that YAML would not read as strings, and characters that it must escape.
    static const char* const known[] = {"",    "~",  "true", "0x1f", " a ",  "a: b",
                                        "- c", "#d", "1e3",  ".nan", "null", "'",
                                        "\"",  "\\", "---",  "...",  "1_0",  "12:30",
                                        "=",   "<<", "no",   "e\n",  "\tf",  "g\r\n\x1b[31m"};
    std::size_t bound = member.string_upper_bound_ != 0 ? member.string_upper_bound_ : 300;
    target.clear();
    if (options_.has_any_text && below(3) == 0) {
      for (const char* letter = known[below(std::size(known))]; *letter != 0; ++letter)
        target.push_back(static_cast<typename String::value_type>(*letter));
    } else {
      for (std::size_t n = below(4) == 0 ? bound : below(std::min<std::size_t>(bound, 20)); n > 0;
           --n) {
        const auto any = static_cast<typename String::value_type>(random_());
        target.push_back(options_.has_any_text && below(2) == 0
                             ? any
                             : static_cast<typename String::value_type>('a' + below(26)));
      }
    }
    if (target.size() > bound) target.resize(bound);
  }
  void fill_element(const MessageMember& member, std::byte* at, int depth) {
    switch (member.type_id_) {
      case ros::ROS_TYPE_MESSAGE:
        return fill(agnocast::detail::nested_members(member), at, depth + 1);
      case ros::ROS_TYPE_STRING:
        return text(member, *reinterpret_cast<std::string*>(at));
      case ros::ROS_TYPE_WSTRING:
        return text(member, *reinterpret_cast<std::u16string*>(at));
      case ros::ROS_TYPE_FLOAT:
        return floating<float>(at);
      case ros::ROS_TYPE_DOUBLE:
        return floating<double>(at);
      case ros::ROS_TYPE_BOOLEAN:
        *at = std::byte(below(2));
        return;
      case ros::ROS_TYPE_INT8:
        return integer<std::int8_t>(at);
      case ros::ROS_TYPE_INT16:
        return integer<std::int16_t>(at);
      case ros::ROS_TYPE_UINT16:
      case ros::ROS_TYPE_WCHAR:
        return integer<std::uint16_t>(at);
      case ros::ROS_TYPE_INT32:
        return integer<std::int32_t>(at);
      case ros::ROS_TYPE_UINT32:
        return integer<std::uint32_t>(at);
      case ros::ROS_TYPE_INT64:
        return integer<std::int64_t>(at);
      case ros::ROS_TYPE_UINT64:
        return integer<std::uint64_t>(at);
      default:
        return integer<std::uint8_t>(at);
    }
  }

  std::mt19937_64 random_;
  Options options_;
};

/// Equal NaNs count as equal; -0 is not 0. The first difference goes to `where`.
inline bool are_same(const MessageMembers& members, const void* a, const void* b,
                     std::string* where = nullptr) {
  const auto same_element = [&](const MessageMember& member, const std::byte* x,
                                const std::byte* y) {
    if (member.type_id_ == ros::ROS_TYPE_MESSAGE)
      return are_same(agnocast::detail::nested_members(member), x, y, where);
    if (member.type_id_ == ros::ROS_TYPE_STRING)
      return *reinterpret_cast<const std::string*>(x) == *reinterpret_cast<const std::string*>(y);
    if (member.type_id_ == ros::ROS_TYPE_WSTRING)
      return *reinterpret_cast<const std::u16string*>(x) ==
             *reinterpret_cast<const std::u16string*>(y);
    if (member.type_id_ == ros::ROS_TYPE_FLOAT && std::isnan(*reinterpret_cast<const float*>(x)))
      return std::isnan(*reinterpret_cast<const float*>(y));
    if (member.type_id_ == ros::ROS_TYPE_DOUBLE && std::isnan(*reinterpret_cast<const double*>(x)))
      return std::isnan(*reinterpret_cast<const double*>(y));
    return std::memcmp(x, y, agnocast::detail::ros_element_layout(member.type_id_).bytes) == 0;
  };
  for (std::uint32_t i = 0; i < members.member_count_; ++i) {
    const MessageMember& member = members.members_[i];
    const void* const x = static_cast<const std::byte*>(a) + member.offset_;
    const void* const y = static_cast<const std::byte*>(b) + member.offset_;
    bool same = element_count(member, x) == element_count(member, y);
    if (is_bit_vector(member)) {
      same = *static_cast<const std::vector<bool>*>(x) == *static_cast<const std::vector<bool>*>(y);
    } else {
      for (std::size_t n = 0; same && n < element_count(member, x); ++n)
        same = same_element(member, element_at(member, x, n), element_at(member, y, n));
    }
    if (same) continue;
    if (where != nullptr) *where = std::string(member.name_) + (where->empty() ? "" : "." + *where);
    return false;
  }
  return true;
}

}  // namespace agnocast::test
