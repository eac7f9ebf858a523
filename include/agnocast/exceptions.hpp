// SPDX-License-Identifier: Apache-2.0
//
// Exceptions, also for programs without them (-fno-exceptions). The library throws from its own
// code; in such a program that ends in std::terminate, which prints the reason. Functions that
// return a Result, and the whole data path, throw nothing there.
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

/// Returns body(). If it throws, returns no_memory() for a std::bad_alloc and thrown() otherwise.
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
