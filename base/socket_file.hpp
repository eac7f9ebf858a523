// SPDX-License-Identifier: Apache-2.0
//
// The files of a socket: its entry and the lock beside it, where other users may have made the same names
// first. No link is followed, and nothing of another user is used or changed.
#pragma once

#include <agnocast/result.hpp>
#include <base/unique_fd.hpp>

#include <sys/types.h>

#include <string>

namespace agnocast {

/// Opens the lock file at `path`, or makes it. Errors: permission_denied, when a link or something of another
/// user lies there (the text says which); os_failure.
[[nodiscard]] Result<UniqueFd> open_lock_file(const std::string& path) noexcept;

/// chmod() follows links, and not every kernel knows an fchmodat() that does not. The entry itself is opened,
/// and reached through that. False: errno says why; EPERM when it is no socket of this user.
bool set_mode_of_socket(const std::string& path, mode_t mode) noexcept;

}  // namespace agnocast
