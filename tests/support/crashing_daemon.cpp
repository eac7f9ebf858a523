// SPDX-License-Identifier: Apache-2.0
//
// For a daemon that is compiled with crash points: the file that AGNOCAST_TEST_CRASH_AT names holds a
// number, and the process that finds it dies at that crash point. It takes the file away first, so
// the next one lives; `reached` beside it says how many it passed, if it came so far as to end.

#include <journal/crash_point.hpp>

#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <fstream>

namespace agnocast {
namespace {

[[maybe_unused]] const bool armed = [] {
  const char* const path = std::getenv("AGNOCAST_TEST_CRASH_AT");
  if (path == nullptr) return false;
  std::uint64_t n = 0;
  std::ifstream file(path);
  // The supervisor is the same program, and never reaches a crash point.
  if (std::getenv("NOTIFY_SOCKET") == nullptr || std::getenv("LISTEN_FDS") == nullptr ||
      !(file >> n))
    return false;
  ::unlink(path);
  crash_points::arm(n);
  return true;
}();

}  // namespace
}  // namespace agnocast
