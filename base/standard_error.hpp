// SPDX-License-Identifier: Apache-2.0
//
// What programs say on stderr, without waiting: whoever should read a pipe and does not must not stop
// the daemon, its supervisor, or the last words of either.
//
// The flag O_NONBLOCK belongs to everybody who has the same stderr, so it is not set there: a socket
// takes MSG_DONTWAIT, and a pipe or terminal is opened once more for each line.
#pragma once

#include <string_view>

namespace agnocast {

/// False when it was lost, as a whole or its end. What is longer than PIPE_BUF may be cut by others.
bool say_on_stderr(std::string_view text) noexcept;

}  // namespace agnocast
