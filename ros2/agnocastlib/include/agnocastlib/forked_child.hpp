// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace agnocastlib {

/// Returns whether this process was forked, without exec, by one that used this library. There,
/// locks may be held for ever by threads that it does not have, and rclcpp's logging would write
/// to the parent's DDS: what this library keeps for the process is left alone. Any thread.
bool is_forked_child() noexcept;

}  // namespace agnocastlib
