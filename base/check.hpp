// SPDX-License-Identifier: Apache-2.0
//
// AGNOCAST_CHECK: checks an invariant of our own code, in every build. For the programs and the
// tests only: they print and abort, and the daemon's next start recovers its state. The library
// never uses it (a library does not end its process). Never check input from a peer with it.
#pragma once

#include <base/text/standard_error.hpp>

#include <algorithm>
#include <cstdio>
#include <cstdlib>

namespace agnocast {

[[noreturn]] inline void check_failed(const char* what, const char* file, int line) noexcept {
  char text[1024];
  const int bytes = std::snprintf(text, sizeof text, "agnocast: broken invariant: %s (%s:%d)\n",
                                  what, file, line);
  say_on_stderr({text, std::min(sizeof text - 1, static_cast<std::size_t>(bytes))});
  std::abort();
}

}  // namespace agnocast

#define AGNOCAST_CHECK(condition) \
  ((condition) ? static_cast<void>(0) : ::agnocast::check_failed(#condition, __FILE__, __LINE__))
