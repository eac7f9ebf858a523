// SPDX-License-Identifier: Apache-2.0
//
// Reads rosidl's introspection tables in the user's translation unit, because only its compiler
// knows their layout.
//
// Members of rosidl's tables are accessed by name only: Humble, Jazzy and Lyrical each added
// some.
#pragma once

#include <agnocast/message_type.hpp>

#include <rosidl_runtime_cpp/message_initialization.hpp>
#include <rosidl_typesupport_introspection_cpp/field_types.hpp>
#include <rosidl_typesupport_introspection_cpp/message_introspection.hpp>

#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <utility>

namespace agnocast {
namespace detail {

using RosMember = rosidl_typesupport_introspection_cpp::MessageMember;
using RosMembers = rosidl_typesupport_introspection_cpp::MessageMembers;

inline const RosMembers& nested_members(const RosMember& member) noexcept {
  return *static_cast<const RosMembers*>(member.members_->data);
}

// ROS 2 Lyrical marks members of type rosidl::Buffer.
template <class Member, class = void>
struct BufferMark {
  static bool of(const Member&) noexcept { return false; }
};
template <class Member>
struct BufferMark<Member, std::void_t<decltype(std::declval<const Member&>().is_rosidl_buffer_)>> {
  static bool of(const Member& member) noexcept { return member.is_rosidl_buffer_; }
};

struct RosElementLayout {
  std::uint32_t bytes = 0;
  std::uint32_t alignment = 0;
  template <class T>
  static constexpr RosElementLayout of() noexcept {
    return {sizeof(T), alignof(T)};
  }
};

// Returns sizeof and alignof one element that is no message; zeros for an unknown number, which
// the library refuses.
inline RosElementLayout ros_element_layout(std::uint8_t type_id) noexcept {
  namespace ros = rosidl_typesupport_introspection_cpp;
  switch (type_id) {
    case ros::ROS_TYPE_BOOLEAN:
      return RosElementLayout::of<bool>();
    case ros::ROS_TYPE_CHAR:
    case ros::ROS_TYPE_OCTET:
    case ros::ROS_TYPE_UINT8:
    case ros::ROS_TYPE_INT8:
      return RosElementLayout::of<std::uint8_t>();
    case ros::ROS_TYPE_WCHAR:
    case ros::ROS_TYPE_UINT16:
    case ros::ROS_TYPE_INT16:
      return RosElementLayout::of<std::uint16_t>();
    case ros::ROS_TYPE_FLOAT:
      return RosElementLayout::of<float>();
    case ros::ROS_TYPE_UINT32:
    case ros::ROS_TYPE_INT32:
      return RosElementLayout::of<std::uint32_t>();
    case ros::ROS_TYPE_DOUBLE:
      return RosElementLayout::of<double>();
    case ros::ROS_TYPE_UINT64:
    case ros::ROS_TYPE_INT64:
      return RosElementLayout::of<std::uint64_t>();
    case ros::ROS_TYPE_LONG_DOUBLE:
      return RosElementLayout::of<long double>();
    case ros::ROS_TYPE_STRING:
      return RosElementLayout::of<std::string>();
    case ros::ROS_TYPE_WSTRING:
      return RosElementLayout::of<std::u16string>();
    default:
      return {};
  }
}

inline ElementKind ros_element_kind(std::uint8_t type_id) noexcept {
  namespace ros = rosidl_typesupport_introspection_cpp;
  switch (type_id) {
    case ros::ROS_TYPE_BOOLEAN:
      return ElementKind::boolean;
    case ros::ROS_TYPE_STRING:
      return ElementKind::string;
    case ros::ROS_TYPE_WSTRING:
      return ElementKind::u16string;
    case ros::ROS_TYPE_MESSAGE:
      return ElementKind::message;
    default:
      return ElementKind::primitive;
  }
}

inline MessageTable read_ros_message(const void* table) {
  const RosMembers& members = *static_cast<const RosMembers*>(table);
  return {members.message_namespace_, members.message_name_, members.size_of_,
          members.member_count_};
}

inline FieldTable read_ros_field(const void* table, std::size_t index) {
  const RosMember& member = static_cast<const RosMembers*>(table)->members_[index];
  ArrayKind array = ArrayKind::none;
  if (member.is_array_ && member.is_upper_bound_) {
    array = ArrayKind::bounded;
  } else if (member.is_array_) {
    array = member.array_size_ != 0 ? ArrayKind::fixed : ArrayKind::unbounded;
  }
  return {member.name_,
          ros_element_kind(member.type_id_),
          array,
          member.type_id_,
          BufferMark<RosMember>::of(member),
          ros_element_layout(member.type_id_).bytes,
          member.offset_,
          member.array_size_,
          member.string_upper_bound_,
          member.members_ != nullptr ? member.members_->data : nullptr,
          member.size_function,
          member.get_const_function,
          member.resize_function};
}

inline void construct_ros_message(const void* table, void* memory) {
  static_cast<const RosMembers*>(table)->init_function(
      memory, rosidl_runtime_cpp::MessageInitialization::ALL);
}
inline void destroy_ros_message(const void* table, void* memory) {
  static_cast<const RosMembers*>(table)->fini_function(memory);
}

}  // namespace detail

}  // namespace agnocast
