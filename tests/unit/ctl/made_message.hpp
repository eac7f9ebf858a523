// SPDX-License-Identifier: Apache-2.0
//
// A message of a C++ type together with its type's table.
#pragma once

#include <agnocast/generic.hpp>
#include <ctl/messages/message_value.hpp>

#include <utility>

namespace agnocast::test {

template <class T>
class Made {
 public:
  explicit Made(T message = T()) : message_(std::move(message)) {}
  T* operator->() { return &message_; }
  const T& operator*() const { return message_; }
  static IntrospectedType type() {
    return IntrospectedType(*static_cast<const MessageMembers*>(MessageTraits<T>::table()));
  }
  ctl::Value value() const { return ctl::Value::of(type().members(), &message_); }

 private:
  T message_;
};

}  // namespace agnocast::test
