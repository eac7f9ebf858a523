// SPDX-License-Identifier: Apache-2.0
//
// Texts that never end: a Failure's `what` is static, but some of them name what the user wrote.
#pragma once

#include <string>

namespace agnocast {

/// A text equal to `text` that stays valid for ever. Equal ones are stored once, and only so many
/// at all; beyond that the answer is `otherwise`. Any thread.
const char* static_text(const std::string& text, const char* otherwise) noexcept;

}  // namespace agnocast
