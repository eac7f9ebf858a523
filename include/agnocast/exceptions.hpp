// SPDX-License-Identifier: Apache-2.0
//
// Exceptions, and programs that have none (-fno-exceptions). The library throws in its own code: in such a
// program what it throws ends in std::terminate, which says what it was. The functions that return a Result,
// and everything that passes messages on, throw nothing there.
#pragma once

#include <agnocast/export.hpp>
#include <agnocast/result.hpp>

#include <new>

namespace agnocast::detail {

#if defined(__cpp_exceptions)
inline constexpr bool has_exceptions = true;
#else
inline constexpr bool has_exceptions = false;
#endif

/// Throws Error.
[[noreturn]] AGNOCAST_PUBLIC void throw_error(const Failure& failure);
/// Throws std::bad_array_new_length.
[[noreturn]] AGNOCAST_PUBLIC void throw_bad_array_new_length();

/// `body()`; what it throws is answered instead by `no_memory()`, if it is a std::bad_alloc, or else by `thrown()`.
template <class Body, class NoMemory, class Thrown>
auto guarded(const Body& body, [[maybe_unused]] const NoMemory& no_memory,
             [[maybe_unused]] const Thrown& thrown) -> decltype(body()) {
#if defined(__cpp_exceptions)
  try {
    return body();
  } catch (const std::bad_alloc&) {
    return no_memory();
  } catch (...) {
    return thrown();
  }
#else
  return body();
#endif
}

}  // namespace agnocast::detail
