// SPDX-License-Identifier: Apache-2.0
//
// Messages for tests of the rmw's core, by type: their support, random ones, the same in C.
#pragma once

#include <ros2/rmw_agnocast_cpp/core/message_support.hpp>
#include <tests/support/messages/everything_in_c.hpp>
#include <tests/support/messages/random_message.hpp>

#include <gtest/gtest.h>

#include <cstdint>
#include <utility>

namespace agnocast::rmw {

using agnocast::test::InC;
using agnocast::test::make_in_c;
using agnocast_test_msgs::msg::Everything;
using agnocast_test_msgs::msg::Forest;

/// Returns the value; throws the reason why there is none.
template <class T>
T valued(Result<T> result) {
  if (!result) throw Error(result.error());
  return std::move(*result);
}
template <class T>
const rosidl_message_type_support_t* cpp_handle() {
  return rosidl_typesupport_cpp::get_message_type_support_handle<T>();
}
template <class T>
MessageSupport cpp_support() {
  return valued(MessageSupport::of(cpp_handle<T>()));
}
template <class T>
MessageSupport c_support() {
  return valued(MessageSupport::of(InC<T>::handle()));
}
/// Without NaN, so that it is equal to its copies.
template <class T>
T random_message(std::uint64_t seed) {
  T message;
  agnocast::test::RandomMessages(seed, {false, true})
      .fill(cpp_support<T>().type().members(), &message);
  return message;
}
template <class T>
auto in_c_of(const T& message) {
  auto made = make_in_c<T>();
  EXPECT_TRUE(c_support<T>().c_layout()->to_c(&message, made.get()));
  return made;
}

}  // namespace agnocast::rmw
