// SPDX-License-Identifier: Apache-2.0
//
// Problem: the reason why a command failed, as a value; main() prints it in the two lines that all
// our programs use and exits with its status.
//
//   agnocast-ctl: what: why
//   hint: a command, or an instruction
#pragma once

#include <agnocast/error.hpp>

#include <tl/expected.hpp>

#include <cstdint>
#include <string>

namespace agnocast::ctl {

enum class Status : std::uint8_t {
  done = 0,
  failed = 1,
  wrong_usage = 2,
  not_reachable = 3,
  no_such_thing = 4,
  permission_denied = 5,
  check_failed = 6,
  timed_out = 124,  // as timeout(1) exits
};

struct Problem {
  Status status = Status::failed;
  std::string what;
  std::string why;
  std::string hint;
  Errc code = Errc::ok;  // from the daemon or the connection
};

template <class T>
using Outcome = tl::expected<T, Problem>;

inline tl::unexpected<Problem> problem(Status status, std::string what, std::string why,
                                       std::string hint) {
  return tl::unexpected<Problem>(Problem{status, std::move(what), std::move(why), std::move(hint)});
}

}  // namespace agnocast::ctl
