// SPDX-License-Identifier: Apache-2.0
//
// Message types that are found at run time: the half of generic.hpp that needs no header of rosidl.
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/message_type.hpp>
#include <agnocast/result.hpp>
#include <agnocast/type_identity.hpp>

#include <string>
#include <vector>

namespace agnocast::detail {

/// The function that returns the type support of `name`, in a library that stays loaded. Searched as
/// try_find_message_type() says, and with its errors. Any thread.
[[nodiscard]] AGNOCAST_PUBLIC Result<void*> find_type_support(
    const std::string& name, const std::vector<std::string>& paths) noexcept;

/// A type of which nothing is known but what is compared at match: for subscriptions only.
[[nodiscard]] AGNOCAST_PUBLIC Result<MessageType> make_named_type(
    const TypeIdentity& identity) noexcept;

}  // namespace agnocast::detail
