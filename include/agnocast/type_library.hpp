// SPDX-License-Identifier: Apache-2.0
//
// Message types found at run time: the part of generic.hpp that needs no header of rosidl.
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/message_type.hpp>
#include <agnocast/result.hpp>
#include <agnocast/type_identity.hpp>

#include <string>
#include <vector>

namespace agnocast::detail {

/// Returns the function that returns the type support of `name`, in a library that stays loaded.
/// Searches as try_find_message_type(), with the same errors. Any thread.
[[nodiscard]] AGNOCAST_PUBLIC Result<void*> find_type_support(
    const std::string& name, const std::vector<std::string>& paths) noexcept;

/// Makes a type with only its identity: for subscriptions.
[[nodiscard]] AGNOCAST_PUBLIC Result<MessageType> make_named_type(
    const TypeIdentity& identity) noexcept;

}  // namespace agnocast::detail
