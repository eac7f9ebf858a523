// SPDX-License-Identifier: Apache-2.0
//
// Result<T>: a value, or the Failure that prevented it. The only alias of tl::expected in this
// tree; it must not depend on the consumer's language mode, or library and user would disagree
// about a type.
#pragma once

#include <agnocast/error.hpp>

#include <tl/expected.hpp>

#include <string>

namespace agnocast {

/// A T, or the reason why there is none. Functions that return a Result are [[nodiscard]].
template <class T>
using Result = tl::expected<T, Failure>;

/// Makes the failing half of a Result. `what` is static text.
inline tl::unexpected<Failure> fail(Errc code, const char* what, int os_errno = 0) noexcept {
  return tl::unexpected<Failure>(Failure{code, os_errno, what, 0});
}
/// The same with details of this failure: see Failure.
inline tl::unexpected<Failure> fail_with(Errc code, const char* detail, int os_errno = 0) noexcept {
  return tl::unexpected<Failure>(failure_with(code, detail, os_errno));
}
inline tl::unexpected<Failure> fail_with(Errc code, const std::string& detail,
                                         int os_errno = 0) noexcept {
  return fail_with(code, detail.c_str(), os_errno);
}

}  // namespace agnocast
