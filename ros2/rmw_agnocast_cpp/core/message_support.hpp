// SPDX-License-Identifier: Apache-2.0
//
// MessageSupport: what a type support handle of rosidl, of a node in C or in C++, says of its
// messages. Both have one form in shared memory: that of C++.
#pragma once

#include <agnocast/generic.hpp>
#include <agnocast/result.hpp>
#include <bridge/cdr/cdr.hpp>
#include <ros2/rmw_agnocast_cpp/core/c_layout.hpp>

#include <rosidl_runtime_c/message_type_support_struct.h>

#include <optional>
#include <utility>

namespace agnocast::rmw {

/// Cheap to copy. Any thread.
class MessageSupport {
 public:
  /// Finds the introspection behind the handle: in C++, or in C, and then that of C++ by the name
  /// of the type (try_find_message_type). Errors: type_refused (there is none; CDR or CLayout
  /// cannot have the type), type_not_found. Throws std::bad_alloc.
  [[nodiscard]] static Result<MessageSupport> of(const rosidl_message_type_support_t* handle);

  const IntrospectedType& type() const noexcept { return type_; }
  const bridge::CdrType& cdr() const noexcept { return cdr_; }
  /// Null: the node's messages are in C++.
  const CLayout* c_layout() const noexcept { return c_layout_ ? &*c_layout_ : nullptr; }

  /// Returns whether the handle is of this type, in C++: a message of it has the layout of a loan.
  bool is_layout_of(const rosidl_message_type_support_t& handle) const;

  /// Copies a received message into a message of the node, following only what lies `within`: its
  /// windows_of(). Errors and exceptions: as of CLayout::to_c.
  [[nodiscard]] Result<void> to_node(const void* from, void* to, const WindowSet& within) const;

 private:
  MessageSupport(const IntrospectedType& type, bridge::CdrType cdr,
                 std::optional<CLayout> c_layout) noexcept
      : type_(type), cdr_(std::move(cdr)), c_layout_(std::move(c_layout)) {}

  IntrospectedType type_;
  bridge::CdrType cdr_;
  std::optional<CLayout> c_layout_;
};

}  // namespace agnocast::rmw
