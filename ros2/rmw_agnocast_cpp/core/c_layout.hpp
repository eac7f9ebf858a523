// SPDX-License-Identifier: Apache-2.0
//
// CLayout: messages of one type between the two layouts that rosidl gives them. Nodes in C and
// Python have messages in C; shared memory has them in C++, so that every reader finds one layout.
//
//     rosidl_typesupport_introspection_c  ─┐
//                                          ├─ of() ── plan: runs of equal bytes, texts, bits, elements
//     rosidl_typesupport_introspection_cpp ┘
//
// Both tables describe one interface definition. Numbers, and arrays of them, are the same bytes in
// both; strings, sequences and vector<bool> are not. The plan joins members that lie side by side
// in both layouts, so a sequence of points is one memcpy.
#pragma once

#include <agnocast/generic.hpp>
#include <agnocast/residency.hpp>
#include <agnocast/result.hpp>

#include <rosidl_typesupport_introspection_c/message_introspection.h>

#include <memory>

namespace agnocast::rmw {

using CMembers = rosidl_typesupport_introspection_c__MessageMembers;

/// The maximum nesting of messages. ROS's own nest about 4 deep.
inline constexpr int layout_depth_max = 64;

/// Cheap to copy; the tables must outlive it. Any thread may call any function here, for different
/// messages at the same time.
class CLayout {
 public:
  /// Verifies that the tables describe the same members. Allocates. Errors: type_refused with the
  /// member: the tables differ, rosidl::Buffer, an unknown kind, nested deeper than
  /// layout_depth_max. Throws std::bad_alloc.
  [[nodiscard]] static Result<CLayout> of(const CMembers& c, const MessageMembers& cpp);

  /// Replaces the contents of `cpp`, a constructed message, by those of `c`, an initialized message
  /// of this process that no thread changes meanwhile; zeros are initialized as well. Errors:
  /// type_refused: a string or sequence is longer than its type allows. After an error, or an
  /// exception, `cpp` is valid and some of its members are replaced. Throws std::bad_alloc.
  [[nodiscard]] Result<void> to_cpp(const void* c, void* cpp) const;
  /// Replaces the contents of `c`, an initialized message, by those of `cpp`. `within`:
  /// windows_of() a message of another process, which need not be valid; null: the message is this
  /// process's own. Errors: protocol_violation: it refers to memory elsewhere, or is longer than
  /// its type allows. After an error or an exception `c` is valid and some of its members are
  /// replaced. Throws std::bad_alloc.
  [[nodiscard]] Result<void> to_c(const void* cpp, void* c,
                                  const WindowSet* within = nullptr) const;

  struct Plan;

 private:
  explicit CLayout(std::shared_ptr<const Plan> plan) noexcept : plan_(std::move(plan)) {}

  std::shared_ptr<const Plan> plan_;
};

}  // namespace agnocast::rmw
