// SPDX-License-Identifier: Apache-2.0
//
// Writing to stderr without waiting: a reader of the pipe that does not read must not stop the
// daemon, its supervisor, or their last words.
//
// All processes with the same stderr share its flag O_NONBLOCK, so it is not set there: a socket
// takes MSG_DONTWAIT, and a pipe or terminal is opened again for each line.
#pragma once

#include <string_view>

namespace agnocast {

/// Returns false if the text was lost, fully or in part. Text longer than PIPE_BUF may be mixed
/// with other output.
bool say_on_stderr(std::string_view text) noexcept;

}  // namespace agnocast
