// SPDX-License-Identifier: Apache-2.0
//
// The messages of agnocast_test_msgs in C, beside those in C++: functions and tables by type.
#pragma once

#include <agnocast/rosidl.hpp>

#include <agnocast_test_msgs/msg/detail/everything__rosidl_typesupport_introspection_c.h>
#include <agnocast_test_msgs/msg/detail/forest__rosidl_typesupport_introspection_c.h>
#include <agnocast_test_msgs/msg/everything.h>
#include <agnocast_test_msgs/msg/forest.h>
#include <agnocast_test_msgs/msg/everything.hpp>
#include <agnocast_test_msgs/msg/forest.hpp>

#include <memory>

namespace agnocast::test {

/// What rosidl generates for the type in C.
template <class T>
struct InC;

#define AGNOCAST_IN_C(Name)                                                                                    \
  template <>                                                                                                  \
  struct InC<agnocast_test_msgs::msg::Name> {                                                                  \
    using Message = agnocast_test_msgs__msg__##Name;                                                           \
    static constexpr auto handle =                                                                             \
        &rosidl_typesupport_introspection_c__get_message_type_support_handle__agnocast_test_msgs__msg__##Name; \
    static constexpr auto create = &agnocast_test_msgs__msg__##Name##__create;                                 \
    static constexpr auto destroy = &agnocast_test_msgs__msg__##Name##__destroy;                               \
    static constexpr auto are_equal = &agnocast_test_msgs__msg__##Name##__are_equal;                           \
  }
AGNOCAST_IN_C(Everything);
AGNOCAST_IN_C(Forest);
#undef AGNOCAST_IN_C

template <class T>
auto make_in_c() {
  return std::unique_ptr<typename InC<T>::Message, decltype(InC<T>::destroy)>(InC<T>::create(),
                                                                              InC<T>::destroy);
}

}  // namespace agnocast::test
