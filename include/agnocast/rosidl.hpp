// SPDX-License-Identifier: Apache-2.0
//
// Makes every message that rosidl generated (topics, and the two halves of services) a message of
// agnocast. Include it where such types are published or subscribed; link the message package as
// for rclcpp, nothing more.
#pragma once

#include <agnocast/checked_copy.hpp>
#include <agnocast/message_traits.hpp>
#include <agnocast/message_type.hpp>
#include <agnocast/rosidl_tables.hpp>

#include <rosidl_runtime_cpp/traits.hpp>
#include <rosidl_typesupport_introspection_cpp/message_type_support_decl.hpp>

#include <cstddef>
#include <type_traits>

namespace agnocast {

template <class T>
struct MessageTraits<T, std::enable_if_t<rosidl_generator_traits::is_message<T>::value>> {
  static detail::TableReader reader() noexcept {
    return {&detail::read_ros_message, &detail::read_ros_field, &detail::construct_ros_message,
            &detail::destroy_ros_message};
  }
  /// The introspection table, from the type support that is linked with the message package; null
  /// if there is none.
  static const void* table() noexcept {
    const rosidl_message_type_support_t* support =
        rosidl_typesupport_introspection_cpp::get_message_type_support_handle<T>();
    return support != nullptr ? support->data : nullptr;
  }
  /// Copies what a publisher may have made that lies: false if it leads out of `windows`. `to` is a message. Throws
  /// std::bad_alloc.
  static bool copy_checked(const T& from, T& to, const WindowSet& windows) {
    detail::CheckedCopy copy(windows);
    const void* const members = table();
    return members != nullptr && copy.take(&from, sizeof(T)) &&
           copy.message(*static_cast<const detail::RosMembers*>(members),
                        reinterpret_cast<const std::byte*>(&from),
                        reinterpret_cast<std::byte*>(&to));
  }
};

}  // namespace agnocast
