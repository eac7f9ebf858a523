// SPDX-License-Identifier: Apache-2.0

#include <ros2/rmw_agnocast_cpp/core/message_support.hpp>

#include <agnocast/checked_copy.hpp>

#include <rcutils/error_handling.h>
#include <rosidl_typesupport_introspection_c/identifier.h>
#include <rosidl_typesupport_introspection_cpp/identifier.hpp>

#include <cstddef>
#include <cstring>
#include <string>

namespace agnocast::rmw {
namespace {

/// Returns the table of this type support; null if the handle has none.
const void* table_of(const rosidl_message_type_support_t* handle, const char* identifier) {
  const auto* const found = handle->func(handle, identifier);
  // A handle that does not know it leaves an error for rcutils.
  if (found == nullptr) rcutils_reset_error();
  return found != nullptr ? found->data : nullptr;
}

/// "std_msgs/msg/String" of "std_msgs__msg" and "String".
std::string ros_name(const CMembers& members) {
  std::string name = members.message_namespace_;
  for (auto at = name.find("__"); at != std::string::npos; at = name.find("__", at))
    name.replace(at, 2, "/");
  return name + "/" + members.message_name_;
}

}  // namespace

Result<MessageSupport> MessageSupport::of(const rosidl_message_type_support_t* handle) {
  if (handle == nullptr) return fail(Errc::invalid_argument, "there is no type support");
  const auto* members = static_cast<const MessageMembers*>(
      table_of(handle, rosidl_typesupport_introspection_cpp::typesupport_identifier));
  std::optional<CLayout> c_layout;
  if (members == nullptr) {
    const auto* const in_c = static_cast<const CMembers*>(
        table_of(handle, rosidl_typesupport_introspection_c__identifier));
    if (in_c == nullptr)
      return fail(Errc::type_refused, "a type support without introspection, in C or in C++");
    const auto found = try_find_message_type(ros_name(*in_c));
    if (!found) return tl::unexpected<Failure>(found.error());
    members = &found->members();
    Result<CLayout> layout = CLayout::of(*in_c, *members);
    if (!layout) return tl::unexpected<Failure>(layout.error());
    c_layout = std::move(*layout);
  }
  Result<bridge::CdrType> cdr = bridge::CdrType::of(*members);
  if (!cdr) return tl::unexpected<Failure>(cdr.error());
  return MessageSupport(IntrospectedType(*members), std::move(*cdr), std::move(c_layout));
}

bool MessageSupport::is_layout_of(const rosidl_message_type_support_t& handle) const {
  const MessageMembers& own = type_.members();
  const auto* const other = static_cast<const MessageMembers*>(
      table_of(&handle, rosidl_typesupport_introspection_cpp::typesupport_identifier));
  // Two libraries may have a table of the same type.
  return other == &own || (other != nullptr && other->size_of_ == own.size_of_ &&
                           std::strcmp(other->message_namespace_, own.message_namespace_) == 0 &&
                           std::strcmp(other->message_name_, own.message_name_) == 0);
}

Result<void> MessageSupport::to_node(const void* from, void* to, const WindowSet& within) const {
  if (c_layout_) return c_layout_->to_c(from, to, &within);
  agnocast::detail::CheckedCopy copy(within);
  const MessageMembers& members = type_.members();
  if (copy.take(from, members.size_of_) &&
      copy.message(members, static_cast<const std::byte*>(from), static_cast<std::byte*>(to)))
    return {};
  return fail(Errc::protocol_violation, "a message that leads out of its publisher's memory");
}

}  // namespace agnocast::rmw
