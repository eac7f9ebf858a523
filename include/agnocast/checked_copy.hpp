// SPDX-License-Identifier: Apache-2.0
//
// Copies a received message by rosidl's table without trusting its publisher: each string and
// sequence header is read once, and followed only inside the heap windows that may hold this
// message. See relay.hpp.
#pragma once

#include <agnocast/residency.hpp>
#include <agnocast/rosidl_tables.hpp>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <new>
#include <string>
#include <vector>

namespace agnocast {

/// A string, std::vector or vector<bool> in another process's memory, copied once as raw bytes.
/// The pointers in it are still unchecked. The text of a short string is inside the original
/// object.
template <class T>
class Snapshot {
 public:
  explicit Snapshot(const void* original) noexcept { std::memcpy(bytes_, original, sizeof(T)); }
  const T& operator*() const noexcept { return *std::launder(reinterpret_cast<const T*>(bytes_)); }
  const T* operator->() const noexcept { return &**this; }

 private:
  alignas(T) std::byte bytes_[sizeof(T)];
};

/// The memory that one message may refer to: inside its windows, and in total no more bytes than
/// the windows have, because in a valid message no byte belongs to two strings or sequences. This
/// bounds the work for a message, even for one that refers to itself.
class MessageBounds {
 public:
  /// Larger messages are rejected: CDR counts with 32 bits.
  static constexpr std::uint64_t bytes_max = std::numeric_limits<std::uint32_t>::max();

  explicit MessageBounds(const WindowSet& windows) noexcept : windows_(windows) {
    for (std::size_t i = 0; i < windows.count(); ++i) left_ += windows[i].end - windows[i].begin;
    if (left_ > bytes_max) left_ = bytes_max;
  }
  /// Returns whether `count` elements of `bytes` bytes each lie there, and subtracts them from
  /// the total.
  bool take(const void* first, std::size_t count, std::size_t bytes = 1) noexcept {
    if (count == 0) return true;
    if (bytes != 0 && count > left_ / bytes) return false;
    if (!windows_.contains(first, count * bytes)) return false;
    left_ -= count * bytes;
    return true;
  }

 private:
  WindowSet windows_;
  std::uint64_t left_ = 0;
};

namespace detail {

/// The layout of a std::vector: of its elements, or of the words of a vector<bool>.
struct VectorEnds {
  const std::byte* begin;
  const std::byte* end;
  const std::byte* end_of_storage;
};

/// Returns whether the bits can be copied: they lie in the windows, and the iterators have values
/// that size() and copying can work with: the first bit begins a word, the end offset lies within
/// a word.
#if defined(__GLIBCXX__) && !defined(_GLIBCXX_DEBUG)
static_assert(sizeof(VectorEnds) == sizeof(std::vector<int>));
inline bool take_bits(MessageBounds& bounds, const std::vector<bool>& bits) noexcept {
  const auto begin = bits.begin(), end = bits.end();
  constexpr std::size_t word = sizeof(*begin._M_p);
  const auto first = reinterpret_cast<std::uintptr_t>(begin._M_p);
  const auto last = reinterpret_cast<std::uintptr_t>(end._M_p);
  // size() computes with pointers to words, so a part of a word has no meaning there.
  if (first % word != 0 || last % word != 0 || last < first) return false;
  if (begin._M_offset != 0 || end._M_offset >= word * 8) return false;
  return bounds.take(begin._M_p, (last - first) / word + (end._M_offset != 0 ? 1 : 0), word);
}
#else
// The layout of vector<bool> in this library is unknown.
inline bool take_bits(MessageBounds&, const std::vector<bool>&) noexcept { return false; }
#endif
/// Returns whether the text is aligned, and lies in the publisher's memory or (a short string) in
/// the string object itself, which was checked together with the object that contains it.
template <class Text>
bool take_text(MessageBounds& bounds, const Text& text, const void* original) noexcept {
  constexpr std::size_t letter = sizeof(typename Text::value_type);
  if (reinterpret_cast<std::uintptr_t>(text.data()) % letter != 0) return false;
  const auto at =
      reinterpret_cast<std::uintptr_t>(text.data()) - reinterpret_cast<std::uintptr_t>(original);
  if (at < sizeof(Text) && text.size() <= (sizeof(Text) - at) / letter) return true;
  return bounds.take(text.data(), text.size(), letter);
}

/// copy_by_table() for a message whose publisher is not trusted. Functions return false for an
/// invalid one.
class CheckedCopy {
 public:
  explicit CheckedCopy(const WindowSet& windows) noexcept : bounds_(windows) {}

  bool message(const RosMembers& members, const std::byte* from, std::byte* to) {
    for (std::uint32_t i = 0; i < members.member_count_; ++i) {
      const RosMember& member = members.members_[i];
      if (!this->member(member, from + member.offset_, to + member.offset_)) return false;
    }
    return true;
  }
  bool take(const void* first, std::size_t bytes) noexcept { return bounds_.take(first, bytes); }

 private:
  static std::size_t stride_of(const RosMember& member) {
    namespace ros = rosidl_typesupport_introspection_cpp;
    return member.type_id_ == ros::ROS_TYPE_MESSAGE ? nested_members(member).size_of_
                                                    : ros_element_layout(member.type_id_).bytes;
  }
  bool member(const RosMember& member, const std::byte* from, std::byte* to) {
    namespace ros = rosidl_typesupport_introspection_cpp;
    if (!member.is_array_) return elements(member, from, to, 1);
    if (member.array_size_ != 0 && !member.is_upper_bound_)
      return elements(member, from, to, member.array_size_);
    if (member.type_id_ == ros::ROS_TYPE_BOOLEAN) return bits(member, from, to);
    const Snapshot<VectorEnds> ends(from);
    const std::size_t stride = stride_of(member);
    if (ends->end < ends->begin) return false;
    const auto bytes = static_cast<std::size_t>(ends->end - ends->begin);
    const std::size_t count = bytes / stride;
    if (bytes % stride != 0 || is_above(count, member) || !bounds_.take(ends->begin, bytes))
      return false;
    member.resize_function(to, count);
    return count == 0 || elements(member, ends->begin,
                                  static_cast<std::byte*>(member.get_function(to, 0)), count);
  }
  static bool is_above(std::size_t count, const RosMember& member) noexcept {
    return member.is_upper_bound_ && count > member.array_size_;
  }
  bool bits(const RosMember& member, const std::byte* from, std::byte* to) {
    const Snapshot<std::vector<bool>> source(from);
    if (!take_bits(bounds_, *source) || is_above(source->size(), member)) return false;
    *reinterpret_cast<std::vector<bool>*>(to) = *source;
    return true;
  }
  bool elements(const RosMember& member, const std::byte* from, std::byte* to, std::size_t count) {
    namespace ros = rosidl_typesupport_introspection_cpp;
    const std::size_t stride = stride_of(member);
    for (std::size_t i = 0; i < count; ++i, from += stride, to += stride) {
      switch (member.type_id_) {
        case ros::ROS_TYPE_MESSAGE:
          if (!message(nested_members(member), from, to)) return false;
          break;
        case ros::ROS_TYPE_STRING:
          if (!text<std::string>(member, from, to)) return false;
          break;
        case ros::ROS_TYPE_WSTRING:
          if (!text<std::u16string>(member, from, to)) return false;
          break;
        case ros::ROS_TYPE_BOOLEAN:  // any other byte is undefined to read
          *to = std::byte(*from != std::byte{0});
          break;
        default:
          std::memcpy(to, from, count * stride);
          return true;
      }
    }
    return true;
  }
  template <class Text>
  bool text(const RosMember& member, const std::byte* from, std::byte* to) {
    const Snapshot<Text> source(from);
    const std::size_t size = source->size();
    if (member.string_upper_bound_ != 0 && size > member.string_upper_bound_) return false;
    if (!take_text(bounds_, *source, from)) return false;
    reinterpret_cast<Text*>(to)->assign(source->data(), size);
    return true;
  }

  MessageBounds bounds_;
};

}  // namespace detail

}  // namespace agnocast
