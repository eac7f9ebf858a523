// SPDX-License-Identifier: Apache-2.0
//
// AGNOCAST_CHECK: an invariant of our own, always looked at. For the programs and the tests only:
// they print and abort, and what a daemon leaves behind is recovered by its next start. The library
// never uses it (a library does not end its host). What a peer wrote is input and never checked
// with this.
#pragma once

#include <cstdio>
#include <cstdlib>

namespace agnocast {

[[noreturn]] inline void check_failed(const char* what, const char* file, int line) noexcept {
  std::fprintf(stderr, "agnocast: broken invariant: %s (%s:%d)\n", what, file, line);
  std::abort();
}

}  // namespace agnocast

#define AGNOCAST_CHECK(condition) \
  ((condition) ? static_cast<void>(0) : ::agnocast::check_failed(#condition, __FILE__, __LINE__))
